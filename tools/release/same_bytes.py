"""The same files always become the same bytes of a .tar.gz.

setuptools builds a wheel that depends on its files and SOURCE_DATE_EPOCH alone. Its sdist also holds the times, owners and order
in which the files lay on the disk, and gzip adds the time of packing.
"""

import gzip
import io
import tarfile


def normalised_tar(archive: bytes, seconds: int) -> bytes:
    """A .tar.gz with the same files, sorted by name, of one time and owner. ValueError: it holds a link or a device."""
    read, packed = io.BytesIO(archive), io.BytesIO()
    with tarfile.open(fileobj=read) as old, tarfile.open(fileobj=packed, mode="w", format=tarfile.PAX_FORMAT) as new:
        for member in sorted(old.getmembers(), key=lambda member: member.name):
            if not (member.isfile() or member.isdir()):
                raise ValueError(f"{member.name} is neither a file nor a folder")
            plain = tarfile.TarInfo(member.name)
            plain.type, plain.size, plain.mtime = member.type, member.size, seconds
            plain.mode = 0o755 if member.isdir() or member.mode & 0o100 else 0o644
            new.addfile(plain, old.extractfile(member) if member.isfile() else None)
    out = io.BytesIO()
    with gzip.GzipFile(filename="", mode="wb", compresslevel=9, fileobj=out, mtime=seconds) as file:
        file.write(packed.getvalue())
    return out.getvalue()

"""Named limits on the size of a stream or a mesh. All are strict: exceeding a limit is a LimitError, exit code 6."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Limits:
    """Limits on what a stream or mesh file may need, with defaults for a desktop; 0 or None switches a limit off.

    file_bytes: whole stream; vertices, faces: over all units; voxels: over all fields, including referenced texels; texels: of
    one image, referenced or not; image_pixels: of one image of a mesh file, as many as a field's image may have; samples: of
    voxelisation and rows of texels, over all fields (time grows with it: about 20 million a second and core); latents: numbers
    of a payload that a network reads, two a byte; metadata_bytes; isolate_bytes, isolate_seconds: for --isolate.
    """

    file_bytes: int | None = 256 << 20
    vertices: int | None = 1 << 24
    faces: int | None = 1 << 24
    voxels: int | None = 1 << 26
    texels: int | None = 1 << 27
    image_pixels: int | None = 1 << 27
    samples: int | None = 1 << 31
    latents: int | None = 1 << 28
    metadata_bytes: int | None = 1 << 20
    isolate_bytes: int | None = 4 << 30
    isolate_seconds: int | None = 120

    def __post_init__(self):
        for name in self.__dataclass_fields__:
            object.__setattr__(self, name, getattr(self, name) or None)


UNLIMITED = Limits(**dict.fromkeys(Limits.__dataclass_fields__))  # for a stream that the same process has made
_MI = 1 << 20
LEVELS = {  # bitstream_spec.md 10.1, whose table is made from this one; 3 is what this decoder promises by default
    1: Limits(file_bytes=16 * _MI, vertices=_MI // 4, faces=_MI // 4, voxels=2 * _MI, texels=4 * _MI, samples=64 * _MI,
              latents=8 * _MI, metadata_bytes=1 << 16),
    2: Limits(file_bytes=64 * _MI, vertices=2 * _MI, faces=2 * _MI, voxels=16 * _MI, texels=16 * _MI, samples=512 * _MI,
              latents=64 * _MI, metadata_bytes=1 << 18),
    3: Limits(),
}


def level_of(needs: dict[str, int]) -> int | None:
    """Return the lowest conformance level (spec 10.1) whose bounds hold what a stream needs, None above the last level. needs:
    counts by names of Limits' fields."""
    for level, bounds in LEVELS.items():
        if all(count <= getattr(bounds, name) for name, count in needs.items()):
            return level
    return None

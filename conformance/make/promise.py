"""Holds the promise that a stream of version 1 or later decodes to the same values for ever: conformance/promise.json names the
streams, and the glTF files with streams, and has two SHA-256 of each: of its bytes, and of what it decodes or expands to.
conformance/run.py and run_containers.py decode them.

    python conformance/make/promise.py            # exit 7 with the names of those that changed, vanished or were never promised
    python conformance/make/promise.py --add      # promises what is new; what was promised before stays as it is
"""

import hashlib
import json
import sys
from pathlib import Path

from texfcodec.bitstream.syntax import VERSION

HOME = Path(__file__).resolve().parents[1]
LIST = "promise.json"


def promised(home=HOME):
    """{vector: [SHA-256 of the stream, SHA-256 of what it decodes to]} of the list."""
    path = home / LIST
    return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}


def changed(streams):
    """Return the names in streams, {vector: its bytes}, that are promised with other bytes."""
    digest = lambda data: hashlib.sha256(data).hexdigest()
    return [name for name, (mark, _) in promised().items() if name in streams and mark != digest(streams[name])]


def current(home=HOME):
    """The same of the vectors that are there; what is refused promises nothing."""
    out, digest = {}, lambda text: hashlib.sha256(text).hexdigest()
    for path in sorted(home.glob("container/*/expected.json")):
        primitives = json.loads(path.read_text(encoding="utf-8")).get("primitives")
        if primitives is not None:
            texts = [path.with_name("in.glb").read_bytes(), json.dumps(primitives, sort_keys=True).encode()]
            out[path.parent.relative_to(home).as_posix()] = [digest(text) for text in texts]
    for path in sorted(home.glob("*/*/case.json")):
        case = json.loads(path.read_text(encoding="utf-8"))
        if "lods" in case:
            texts = [path.with_name("in.texf").read_bytes(), json.dumps(case["lods"], sort_keys=True).encode()]
            out[path.parent.relative_to(home).as_posix()] = [digest(text) for text in texts]
    return out


def broken(old, new):
    """What was promised and is not so any more, a sentence each."""
    for name, hashes in old.items():
        if name not in new:
            yield f"{name} is gone"
        elif new[name] != hashes:
            yield f"{name} {'is another stream' if new[name][0] != hashes[0] else 'decodes to other values'}"


def renewed(old, new):
    """The list with all that is new. Raises ValueError where a promise is broken."""
    faults = list(broken(old, new))
    if faults:
        raise ValueError("; ".join(faults))
    return {**old, **new}


def main(arguments):
    """Checks the list, or writes it."""
    old, new = promised(), current()
    if not arguments:
        faults = [*broken(old, new), *(f"{name} is not promised" for name in new.keys() - old.keys())]
        print("\n".join(faults or [f"{len(old)} streams of version {VERSION} as promised"]))
        return 7 if faults else 0
    try:
        promise = renewed(old, new)
    except ValueError as error:
        print(error)
        return 7
    (HOME / LIST).write_text(json.dumps(dict(sorted(promise.items())), indent=0) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

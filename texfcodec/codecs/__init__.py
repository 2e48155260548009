"""The registry of codecs. It returns a codec by the name that users type or by the id in a stream.

Another package registers a codec as an entry point of the group texfcodec.codecs. The entry point has the codec's name and refers
to a class derived from base.PlaneCodec or base.JointCodec with an id of PRIVATE_IDS.
"""

from contextlib import suppress
from functools import lru_cache
from importlib import import_module

from ..errors import SupportError
from .base import PRIVATE_IDS, Codec, JointCodec, PlaneCodec

GROUP = "texfcodec.codecs"
OURS = {"raht": (0, "raht.raht_codec", "Raht"), "3dntc": (1, "neural.neural_codec", "Neural"),
        "constant": (2, "constant", "Constant")}  # name: id, module, class


@lru_cache(maxsize=64)
def _ours(name: str) -> Codec:
    _, module, kind = OURS[name]
    return getattr(import_module(f".{module}", __name__), kind)()


def _points() -> list:
    """Entry points of GROUP. If the entry points of any package cannot be parsed, those of that package are skipped."""
    from importlib.metadata import distributions, entry_points  # here: it takes 0.03 s, and few streams need a plug-in

    try:
        return list(entry_points(group=GROUP))
    except Exception:
        points: list = []
        for package in distributions():
            with suppress(Exception):
                points += package.entry_points.select(group=GROUP)
        return points


@lru_cache(maxsize=1)
def _plugins() -> dict:
    """Entry points of plug-in codecs by name, not yet loaded. A plug-in cannot replace one of our codecs."""
    plugins: dict = {}
    for point in _points():
        if point.name not in OURS:
            plugins.setdefault(point.name, {})[point.value] = point  # a package that is installed twice is one plug-in
    return {name: list(points.values()) for name, points in plugins.items()}


@lru_cache(maxsize=64)
def _plugin(name: str) -> Codec:
    """The codec of an entry point, with its class and id checked. Exceptions of its later calls pass through unchanged."""
    points = _plugins()[name]
    if len(points) > 1:
        raise SupportError("TXF-U08", f"several plug-ins register a codec named {name!r}",
                           value=", ".join(sorted(point.value for point in points)))
    try:
        codec = points[0].load()()
    except (Exception, SystemExit) as error:
        raise SupportError("TXF-U08", f"the codec {name!r} of a plug-in cannot be loaded from {points[0].value}",
                           reason=f"{type(error).__name__}: {error}"[:300]) from error
    if not isinstance(codec, (PlaneCodec, JointCodec)) or getattr(codec, "name", None) != name:
        raise SupportError("TXF-U08", f"the plug-in {points[0].value} does not provide a codec named {name!r}")
    number = getattr(codec, "id", None)
    if type(number) is not int or number not in PRIVATE_IDS:
        raise SupportError("TXF-U08", f"the codec {name!r} of a plug-in claims an id outside the private range",
                           value=repr(number)[:80], allowed=f"{PRIVATE_IDS[0]}..{PRIVATE_IDS[-1]}")
    return codec


def our_codecs() -> list[Codec]:
    """The codecs of the specification, by id."""
    return [_ours(name) for name in OURS]


def codec_names() -> list[str]:
    """Values of --codec: the codecs of the specification that users may choose, then those of plug-ins."""
    return [codec.name for codec in our_codecs() if codec.chosen] + sorted(_plugins())


def codec_of(name: str) -> Codec:
    """Return the codec of this name. Raises SupportError for an unknown name and for a plug-in that cannot be used."""
    if isinstance(name, str):
        if name in OURS:
            return _ours(name)
        if name in _plugins():
            return _plugin(name)
    raise SupportError("TXF-U06", "no codec of this name is installed", value=name, allowed=", ".join(codec_names()))


def codec_of_unit(values: dict) -> Codec:
    """Return the codec of an attribute unit (5.7): by codec_id, or by codec_name and id if the id is private. values: syntax
    values of the unit. Raises SupportError."""
    number, name = values["codec_id"], values.get("codec_name")
    if number not in PRIVATE_IDS:
        for ours, (id, *_) in OURS.items():
            if id == number:
                return _ours(ours)
        raise SupportError("TXF-U02", "unknown attribute codec", clause="5.7", value=number,
                           allowed=[id for id, *_ in OURS.values()])
    if name not in _plugins():
        raise SupportError("TXF-U07", f"the stream needs the codec {name!r}, which is not installed", clause="5.7",
                           value=number)
    codec = _plugin(name)
    if codec.id != number:
        raise SupportError("TXF-U07", f"the installed codec {name!r} has another id than the stream needs", clause="5.7",
                           value=number, allowed=codec.id)
    return codec


def plane_codec_of_unit(values: dict) -> PlaneCodec:
    """Return the codec of a unit that codes one channel group of one field, by codec_of_unit(). values: syntax values of the
    unit, of a stream without a joint unit."""
    codec = codec_of_unit(values)
    assert isinstance(codec, PlaneCodec)
    return codec


def joint_codec_of_unit(values: dict) -> JointCodec:
    """Return the codec of the unit that codes all fields together, by codec_of_unit(). values: its syntax values,
    Stream.joint."""
    codec = codec_of_unit(values)
    assert isinstance(codec, JointCodec)
    return codec

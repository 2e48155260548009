"""Ways of coding a textured mesh that rate_points.py compares: a method is a class in a file of this folder, or in a plug-in.

    @method("astc")
    class Astc(Method):
        options = ("block", "quality")
        def encode(self, scene, options, folder, threads, report): ...
        def decode(self, folder, options, threads, report): ...

A condition file names it by `method = "astc"`. Encoding and decoding run in different processes that share nothing but the job's
folder. A file of this folder imports at its top only what every installation has, so that one missing program hides no other
method.
"""

import hashlib
import importlib.util
import pkgutil
import sys
from abc import ABC, abstractmethod
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

METHODS = {}  # name: class


class Method(ABC):
    """One way of coding textured meshes. options: names that a settings table may hold besides name, group and method."""

    options = ()

    def version(self):
        """What results depend on beside the files of this package and of tools/bench/methods: outside programs, libraries."""
        return ""

    def missing(self, options):
        """Return a sentence on what these options need that is not installed, and how to get it; None if nothing is missing."""
        return None

    def warm_up(self, options, threads):
        """Load kernels and libraries for these options, so that neither the seconds nor the memory of the job include them."""
        return

    @abstractmethod
    def encode(self, scene, options, folder, threads, report):
        """Code a Scene into files of folder. options: dict, of the settings table; report: Report for stages and warnings.

        Returns a JSON-ready dict with "bytes" {"total", "geometry", ...}, where all but geometry is texture-related (UVs too),
        and "reconstruction_sha256", a hash of the values that the decoder must arrive at, None if the encoder has none. Its
        other entries go into the results unchanged.
        """

    @abstractmethod
    def decode(self, folder, options, threads, report):
        """Decode the files that encode() left in folder and return a Texf or a Scene. options: those of encode()."""

    def values_sha256(self, decoded):
        """Return a hash of what decode() returned, to compare with reconstruction_sha256; None if there is none."""
        return None


def method(name):
    """Return a class decorator that registers a Method under a name."""

    def register(cls):
        METHODS[name] = cls
        return cls

    return register


def find(name, plugins=()):
    """Return an instance of the Method with a name. plugins: paths of Python files with further methods. Raises LookupError."""
    for path in plugins:
        _import_file(Path(path))
    missing = []
    if name not in METHODS:
        for module in pkgutil.iter_modules(__path__):
            try:
                import_module(f"{__name__}.{module.name}")
            except ImportError as error:
                missing.append(f"; {module.name} cannot be imported: {error}")
    if name not in METHODS:
        raise LookupError(f"there is no method {name!r}, only {', '.join(sorted(METHODS))}{''.join(missing)}")
    return METHODS[name]()


def versions_of(*packages):
    """Return names and versions of installed packages, for Method.version(); the name alone of one that is not installed."""
    versions = []
    for name in packages:
        try:
            versions.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            versions.append(name)
    return " ".join(versions)


def source_hash(*files):
    """Return 16 hexadecimal digits of a hash of source files, for the version() of a method that uses code of other files."""
    return hashlib.sha256(b"".join(Path(path).read_bytes() for path in files)).hexdigest()[:16]


def hash_of(*arrays):
    """Return the SHA-256 of arrays in hexadecimal, for values_sha256()."""
    total = hashlib.sha256()
    for values in arrays:
        total.update(np.ascontiguousarray(values))
    return total.hexdigest()


def checked_options(options, defaults, ranges, choices):
    """Return defaults updated by options. ranges: {name: (least, most)} of whole numbers; choices: {name: allowed values}.
    Raises ValueError with the name of an option that is out of range."""
    options = defaults | options
    for name, values in choices.items():
        if options[name] not in values or isinstance(options[name], bool):
            raise ValueError(f"{name} must be one of {', '.join(map(str, values))}, not {options[name]!r}")
    for name, (least, most) in ranges.items():
        if type(options[name]) is not int or not least <= options[name] <= most:
            raise ValueError(f"{name} must be a whole number from {least} to {most}, not {options[name]!r}")
    return options


def _import_file(path):
    spec = importlib.util.spec_from_file_location(f"plugin_{path.stem}", path)
    if spec is None:
        raise LookupError(f"the plug-in {path} is no Python file")
    module = sys.modules[spec.name] = importlib.util.module_from_spec(spec)  # there inspect finds the file of its classes
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise LookupError(f"the plug-in {path} cannot be loaded: {type(error).__name__}: {error}") from error

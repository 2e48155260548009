"""Error families: the thing at fault decides the class and the exit code; everything else is data."""

EXIT_OK, EXIT_USAGE, EXIT_IO, EXIT_STREAM, EXIT_INTERNAL, EXIT_SUPPORT, EXIT_LIMIT, EXIT_DIFFERS = range(8)
EXIT_INTERRUPTED = 130


class TexfError(Exception):
    """Base of all errors that this package raises on purpose.

    code: short stable identifier such as "TXF-S03"; message: one sentence; details: extra machine-readable facts (clause, offset,
    value, allowed, ...), all optional.
    """

    exit_code = EXIT_INTERNAL

    def __init__(self, code: str, message: str, **details: object) -> None:
        super().__init__(message)
        self.code = code
        self.message = message
        self.details = {k: v for k, v in details.items() if v is not None}

    def __str__(self):
        facts = ", ".join(f"{k} {v}" for k, v in self.details.items())
        return f"{self.code}: {self.message}" + (f" ({facts})" if facts else "")

    def __reduce__(self):  # keeps code and details when an error crosses a process boundary
        return (_rebuild, (type(self), self.code, self.message, self.details))

    def as_dict(self) -> dict:
        return {"code": self.code, "message": self.message, **self.details}


class LossWarning(UserWarning):
    """A part of a mesh will look different or is left out. encode() and Texf.save() issue one for each such sentence; the command
    lines print the sentences instead."""


def _rebuild(cls, code, message, details):
    return cls(code, message, **details)


class InputError(TexfError):
    """The user's mesh, image or path is at fault."""

    exit_code = EXIT_IO


class StreamError(TexfError):
    """The .texf file is at fault: it does not follow bitstream_spec.md."""

    exit_code = EXIT_STREAM


class LimitError(TexfError):
    """The stream or mesh asks for more than the configured limits allow."""

    exit_code = EXIT_LIMIT


class SupportError(TexfError):
    """The input is valid but uses a feature that this version does not have."""

    exit_code = EXIT_SUPPORT

"""An engine of the package in the form in which conformance/run.py calls a decoder."""

from conformance.decode_texfcodec import arrays
from texfcodec.errors import TexfError


class EngineDecoder:
    """engine: of DecodeOptions. code: of the last error, None after a decode."""

    asks = False

    def __init__(self, engine):
        self.engine, self.code = engine, None

    def __call__(self, stream, lod, queries=b""):
        self.code = None
        try:
            values = arrays(stream.read_bytes(), lod, engine=self.engine)
            return 0, {f"{name}.bin": content for name, content in values.items()}, ""
        except TexfError as error:
            self.code = error.code
            return error.exit_code, {}, str(error)

"""Every code of the package, in one table: what is wrong, where the specification says so, and what to do. Most are errors;
texf-validate also warns of what is odd about a valid stream, and notes what costs bytes or is seldom meant.

The sites that raise an error say its code themselves; tests/repository/test_findings.py holds both against each other.
bitstream_spec.md and docs/guide/errors.md carry this table as generated blocks (`make spec-tables`).
"""

from dataclasses import dataclass

from .errors import (
    EXIT_INTERNAL,
    EXIT_INTERRUPTED,
    EXIT_LIMIT,
    EXIT_OK,
    EXIT_USAGE,
    InputError,
    LimitError,
    StreamError,
    SupportError,
    TexfError,
)

COMMAND_LINE = "command line"
ERROR, WARNING, NOTE = SEVERITIES = ("error", "warning", "note")


@dataclass(frozen=True)
class Finding:
    """One code. family: its class, or None where only the command lines report it and no exception carries it; clauses: those of
    bitstream_spec.md that are broken or at stake, each with the clauses below it; text: what is wrong; remedy: what to do;
    told_exit: exit code of a finding without family; severity: one of SEVERITIES, less than an error in a valid stream."""

    code: str
    family: type[TexfError] | None
    clauses: tuple[str, ...]
    text: str
    remedy: str
    told_exit: int | None = None
    severity: str = ERROR

    @property
    def family_name(self) -> str:
        if self.severity != ERROR:
            return self.severity
        return COMMAND_LINE if self.family is None else self.family.__name__

    @property
    def exit_code(self) -> int | None:
        return self.told_exit if self.family is None else self.family.exit_code

    def covers(self, clause: str) -> bool:
        """Whether a clause such as "5.7.1" is one of the finding's, or below one of them."""
        return any(clause == one or clause.startswith(one + ".") for one in self.clauses)


_REPAIR = "ask for the file again; it is damaged or was made by a faulty encoder"
_EXPORT = "repair the file in the tool that wrote it, and export it again"
_ENCODER = "tell whoever wrote the encoder"


def _warning(code, clause, text, remedy):
    return Finding(code, None, (clause,), text, remedy, EXIT_OK, WARNING)


def _note(code, clause, text, remedy):
    return Finding(code, None, (clause,), text, remedy, EXIT_OK, NOTE)


FINDINGS = (
    # The stream is invalid.
    Finding("TXF-S01", StreamError, ("5.1",), "the file does not start with the TexF signature", "check that it is a .texf file"),
    Finding("TXF-S02", StreamError, ("5",), "the data end inside an element or a unit", "fetch the file again: it was cut short"),
    Finding("TXF-S03", StreamError, ("5.2",), "the checksum of a unit does not match", "fetch the file again: it was damaged"),
    Finding("TXF-S04", StreamError, ("5",), "a value is out of its range", _REPAIR),
    Finding("TXF-S05", StreamError, ("4.3",), "a variable-length number is not in its shortest form", _REPAIR),
    Finding("TXF-S06", StreamError, ("5",), "a text is not valid UTF-8", _REPAIR),
    Finding("TXF-S07", StreamError, ("5.2",), "a unit is missing at its place, out of order, or there twice", _REPAIR),
    Finding("TXF-S08", StreamError, ("5.2", "5.9"), "bytes are left over in a unit or after the end unit",
            "cut off what was appended to the stream, or ask for the file again"),
    Finding("TXF-S09", StreamError, ("5.6", "5.7"), "a unit names a field, channel group or material that is not there", _REPAIR),
    Finding("TXF-S10", StreamError, ("5.7.2", "5.7.4"), "the lengths in an attribute unit do not add up to its data", _REPAIR),
    Finding("TXF-S11", StreamError, ("5.2", "5.4", "5.5", "5.6", "5.7", "5.10"),
            "the units are not those that the sequence header and the materials promise",
            _REPAIR),
    Finding("TXF-S12", StreamError, ("5.7.1",), "a slice begins past the last node", _REPAIR),
    Finding("TXF-S13", StreamError, ("5.7",), "an attribute unit of all fields together, in a stream with a field over texels",
            _REPAIR),
    Finding("TXF-S14", StreamError, ("5.3.1", "5.4.1"),
            "materials and channel groups of the stream do not go together", _REPAIR),
    Finding("TXF-S20", StreamError, ("5.6",), "the Draco data are not a mesh of the one kind that is allowed", _REPAIR),
    Finding("TXF-S21", StreamError, ("5.6",), "the Draco data have other counts than their unit", _REPAIR),
    Finding("TXF-S22", StreamError, ("5.6",), "the Draco data cannot be decoded", _REPAIR),
    Finding("TXF-S23", StreamError, ("5.6",), "the Draco data have an index, a position or a UV out of range", _REPAIR),
    Finding("TXF-S24", StreamError, ("5.6.3",), "the decoded faces do not have the checksum that was sent", _REPAIR),
    Finding("TXF-S30", StreamError, ("6.4", "6.5", "8.4.2", "8.4.3", "11.3"),
            "the voxels, texels, edges or corners rebuilt from the geometry are not those that were coded", _REPAIR),
    Finding("TXF-S32", StreamError, ("7.10", "8.4.2", "8.4.4", "11.8"),
            "the decoded values do not have the checksum that was sent", _REPAIR),
    Finding("TXF-S40", StreamError, (), "the sandbox of --isolate crashed on the stream, or its answer makes no sense",
            "do not trust the file; report it as SECURITY.md says, unless more --max-isolate-bytes cures it"),
    Finding("TXF-S50", StreamError, ("5.7.4",), "a network parameter is not a number, infinite or of magnitude 2^12 or more",
            _REPAIR),
    # Valid, but not supported.
    Finding("TXF-U01", SupportError, ("5.2",), "the stream has a critical unit that this version does not know",
            "decode with a newer version"),
    Finding("TXF-U02", SupportError, ("5.7",), "the stream has an attribute codec that this version does not know",
            "decode with a newer version"),
    Finding("TXF-U03", SupportError, ("5.3.1",), "a channel group has a number of components that this version does not know",
            "decode with a newer version"),
    Finding("TXF-U04", SupportError, ("5.3",), "the stream is of another version of the format",
            "decode with the version that wrote it"),
    Finding("TXF-U06", SupportError, (), "no codec of this name is installed", "install its plug-in, or take another codec"),
    Finding("TXF-U07", SupportError, ("5.7",), "the stream needs a codec that is not installed", "install its plug-in"),
    Finding("TXF-U08", SupportError, (), "the codec of a plug-in fails, or is none", "repair, update or remove the plug-in"),
    Finding("TXF-U09", SupportError, ("4.3",), "an element has a number whose meaning this version does not know",
            "decode with a newer version"),
    Finding("TXF-U10", SupportError, (), "--engine wasm cannot decode this stream, or wasmtime is not installed",
            "leave --engine out, or install wasmtime"),
    Finding("TXF-U11", SupportError, (), "texf-view has no codec of a plug-in: its page decodes the codecs of the specification",
            "bring the stream to a GLB with texf-dec, and show that"),
    # Over a limit; every limit is a flag of the tools and a field of Limits.
    Finding("TXF-L01", LimitError, ("10",), "the stream is larger than the limit",
            "raise --max-file-bytes if you trust the file"),
    Finding("TXF-L02", LimitError, ("5.6",), "stream or mesh have more vertices than the limit allows",
            "raise --max-vertices, or simplify the mesh"),
    Finding("TXF-L03", LimitError, ("5.6",), "stream or mesh have more faces than the limit allows",
            "raise --max-faces, or simplify the mesh"),
    Finding("TXF-L04", LimitError, ("5.5", "6.3", "6.5"), "the fields have more voxels and texels than the limit allows",
            "raise --max-voxels, or encode with a smaller --resolution or --texel-size"),
    Finding("TXF-L05", LimitError, ("6.3", "6.5"), "the fields need more samples and rows of the surface than the limit allows",
            "raise --max-samples, or encode with a smaller --resolution or --texel-size"),
    Finding("TXF-L06", LimitError, ("5.8",), "the metadata unit is larger than the limit", "raise --max-metadata-bytes"),
    Finding("TXF-L07", LimitError, (), "decoding needs more memory than the sandbox of --isolate may have",
            "raise --max-isolate-bytes if you trust the file"),
    Finding("TXF-L08", LimitError, (), "decoding takes longer than the sandbox of --isolate may",
            "raise --max-isolate-seconds if you trust the file"),
    Finding("TXF-L09", None, (), "the memory of the machine is not enough",
            "free memory, or take a smaller --resolution or --lod", EXIT_LIMIT),
    Finding("TXF-L10", LimitError, ("5.7.4",), "the payload has more latents than the limit allows", "raise --max-latents"),
    Finding("TXF-L11", LimitError, ("5.5",), "an image has more texels than the limit allows",
            "raise --max-texels, or encode with a smaller --texel-size"),
    Finding("TXF-L12", LimitError, (), "coding an asset of a batch takes longer than it may", "raise --limit-seconds"),
    Finding("TXF-L13", LimitError, (), "an asset is too large to be sent to workers that do not see its folder",
            "start the workers where they see it"),
    Finding("TXF-L14", LimitError, (), "the stream has more units than texf-validate looks into",
            "decode it: texf-dec has no such limit"),
    Finding("TXF-L15", LimitError, (), "the system starts no child process for --isolate, or has no room for its folder",
            "make room where temporary files go, or end other processes"),
    # Valid and odd; texf-validate says so.
    _warning("TXF-W01", "5.2", "an ancillary unit is of a type that this version does not know, and is passed over",
             "decode with a newer version if you miss what it holds"),
    _warning("TXF-W02", "5.8", "the metadata are not a JSON object, and are passed over", _ENCODER),
    _warning("TXF-W03", "5.6", "the Draco data go on where Draco has stopped reading",
             "cut the data off, unless somebody keeps something of their own there; " + _ENCODER),
    _warning("TXF-W04", "5.7", "the stream needs a codec of a plug-in, which other decoders do not have",
             "encode with a codec of the specification for everybody else"),
    _warning("TXF-W05", "7.6.2", "a codeword goes on where its last symbol has been read", "cut the bytes off; " + _ENCODER),
    _warning("TXF-W06", "5.7.2", "the counts of bytes by level are not those that a decoder reads",
             "do not fetch coarse levels alone by them; " + _ENCODER),
    _warning("TXF-W07", "12", "a name has control characters, which may steer a terminal or hide what follows",
             "rename the material in the source, and encode it again"),
    _note("TXF-W08", "12", "a name has a path separator, or would be a place above a folder",
          "do not make the name of a file of it unchanged"),
    _note("TXF-W09", "5.4.1", "several materials have the same name", "rename them in the source if somebody tells them apart"),
    _note("TXF-W10", "5.6", "no geometry unit is of a material", "leave the material out of the source"),
    _note("TXF-W11", "5.4.1", "a material names channels that no effect of it reads",
          "leave the maps out, or set the factors that bring them to bear"),
    _note("TXF-W12", "5.3.1", "alpha is coded, and every material is opaque", "leave alpha out"),
    _note("TXF-W13", "5.4.1", "alpha_cutoff of a masked material is 0, which cuts nothing off", "make the material opaque"),
    _note("TXF-W14", "5.6", "several geometry units are of the same field and material",
          "code them as one, which takes fewer bytes"),
    _note("TXF-W15", "5.6", "faces have no area", "leave them out, or take more --position-bits"),
    _note("TXF-W16", "5.6", "faces are there more than once, with the same corners in the same order",
          "leave all but one of them out: which of them is seen is left to chance"),
    _note("TXF-W17", "5.3", "the positions use half of the lattice or less along every axis",
          "fit origin and side to the mesh: coarser positions than need be were coded"),
    _warning("TXF-W18", "5.3", "side is 0 though there are faces, which puts them all in one point of the world", _ENCODER),
    _note("TXF-W19", "5.5", "a field has one voxel or texel, so that all of its surface has one colour",
          "encode with a larger --resolution if it should have more"),
    _note("TXF-W20", "5.5", "less than a sixteenth of a field's image is asked by the surface",
          "crop or pack the image: its memory grows with the whole"),
    _note("TXF-W21", "5.7", "level_shift leaves a plane of one cell on a field of several",
          "code one value (codec 2), or a factor"),
    _note("TXF-W22", "5.3", "the stream is an empty mesh", "look whether the encoder was given the right file"),
    _note("TXF-W23", "5.5", "a field has more voxels a side than the positions have steps",
          "take a smaller --resolution or more --position-bits"),
    # Loading.
    Finding("TXF-I01", InputError, (), "the input does not exist", "check the path"),
    Finding("TXF-I02", InputError, (), "the input is a directory", "name a file"),
    Finding("TXF-I03", InputError, (), "the input cannot be read", "check the file's permissions and its disk"),
    Finding("TXF-I04", InputError, (), "the input is empty", "write or fetch the file again"),
    Finding("TXF-I05", InputError, (), "the suffix names no supported format, or the object is of no supported type",
            "convert it to one of the formats of docs/guide/formats.md"),
    Finding("TXF-I06", InputError, (), "the file does not start as its suffix promises",
            "give the file the suffix of its format"),
    Finding("TXF-I07", InputError, (), "the GLB container is truncated or broken", "fetch or export the file again"),
    Finding("TXF-I08", InputError, (), "the glTF text is not JSON", _EXPORT),
    Finding("TXF-I09", InputError, (), "the glTF structure is malformed: wrong type, missing property, reference to nothing",
            "let the Khronos glTF validator say where, and export the file again"),
    Finding("TXF-I10", InputError, (), "a glTF buffer is missing, unreadable or too short", "put the .bin file beside the .gltf"),
    Finding("TXF-I11", InputError, (), "an accessor or bufferView leaves its buffer", _EXPORT),
    Finding("TXF-I12", InputError, (), "the Draco data of a glTF primitive are broken", _EXPORT),
    Finding("TXF-I13", InputError, (), "a face names a vertex or texture coordinate that does not exist", _EXPORT),
    Finding("TXF-I14", InputError, (), "a position, UV, colour or factor in use is NaN or infinite", _EXPORT),
    Finding("TXF-I15", InputError, (), "there are no triangles", "give a mesh; point clouds and lines are not coded"),
    Finding("TXF-I16", InputError, (), "a texture or material file is missing (a warning unless --strict)",
            "put the file where the mesh names it"),
    Finding("TXF-I17", InputError, (), "an image cannot be decoded (a warning unless --strict)", "save the image again as PNG"),
    Finding("TXF-I18", InputError, (), "texture coordinates are NaN or infinite (a warning unless --strict)", _EXPORT),
    Finding("TXF-I19", InputError, (), "the glTF node graph is not a tree", _EXPORT),
    Finding("TXF-I20", InputError, (), "a line of the OBJ or MTL file cannot be read", "mend the line that the message names"),
    Finding("TXF-I21", InputError, (), "the PLY file is malformed or ends early", _EXPORT),
    Finding("TXF-I22", InputError, (), "the arrays of a mesh object do not fit together", "compare them with Scene's docstring"),
    Finding("TXF-I23", InputError, (), "the STL or OFF file is malformed or ends early", _EXPORT),
    Finding("TXF-I24", InputError, (), "the 3MF or COLLADA file is not the archive or XML that it should be", _EXPORT),
    Finding("TXF-I25", InputError, (), "the stream that a GLB or glTF carries cannot be decoded; its fallback is read (a warning "
            "unless --strict)", "write the file again with texf-dec --carry-stream, or take a newer version"),
    Finding("TXF-I26", InputError, (), "a GLB is given as a stream, and carries none",
            "code it with texf-enc; texf-dec --carry-stream writes a GLB that carries its stream"),
    Finding("TXF-I30", SupportError, (), "the file is compressed with meshopt, and its package or the filter is missing",
            "pip install \"texfcodec[formats]\", or decompress it, e.g. with glTF-Transform"),
    Finding("TXF-I31", SupportError, (), "the file requires an extension that is not supported",
            "export it without the extension"),
    Finding("TXF-I32", SupportError, (), "a base colour texture has no readable source",
            "pip install \"texfcodec[formats]\" for KTX2, or export its image as PNG, JPEG, WebP or AVIF"),
    Finding("TXF-I33", SupportError, (), "the file is of another version of glTF than 2", "convert it to glTF 2"),
    Finding("TXF-I34", SupportError, (), "the mesh is compressed with Draco, and DracoPy is not installed",
            "pip install DracoPy"),
    Finding("TXF-I35", SupportError, (), "the format needs a package that is not installed",
            "pip install \"texfcodec[formats]\""),
    Finding("TXF-I40", LimitError, (), "an image has more pixels than the limit allows",
            "raise --max-image-pixels (and, for streams that keep it, a decoder's --max-texels), or make the image smaller"),
    Finding("TXF-I41", LimitError, (), "the mesh has too many faces or elements, or needs more memory than there is",
            "simplify the mesh"),
    # Encoding.
    Finding("TXF-I50", InputError, (), "an option is unknown, out of range, or does not go with another",
            "take a value that the message allows"),
    Finding("TXF-I51", InputError, (), "no K and QP reach the target", "take a target that the message calls the best or allows"),
    Finding("TXF-I52", InputError, (), "something would be lost, and --strict forbids it",
            "mend what is named, or leave out --strict"),
    Finding("TXF-I54", InputError, (), "the budget of resident bytes holds no grid of latents", "raise --resident-bytes"),
    Finding("TXF-I55", InputError, (), "the checkpoint is of another fit, or cannot be read",
            "name another file, or delete it and begin again"),
    Finding("TXF-I56", InputError, (), "fitting with torch needs an optional extra", "pip install texfcodec[ntc]"),
    Finding("TXF-I57", InputError, (), "a batch names no asset, or its manifest cannot be read",
            "compare the manifest with texf-enc --help"),
    Finding("TXF-I58", InputError, (), "the fit of a payload has diverged: its numbers are none any more",
            "take another --seed, or delete the checkpoint"),
    Finding("TXF-I60", InputError, (), "the mesh has coordinates that are too large", "scale the mesh down"),
    Finding("TXF-I61", InputError, (), "the mesh is too small to be scaled", "scale the mesh up"),
    Finding("TXF-I62", InputError, (), "Draco cannot code the mesh", "report the mesh"),
    Finding("TXF-I63", InputError, (), "no face has area", "take more --position-bits, or repair the mesh"),
    # Asking and measuring.
    Finding("TXF-I70", InputError, (), "an empty asset has no colour to ask for", "do not query a stream without faces"),
    Finding("TXF-I71", InputError, (), "query points are not finite", "leave such points out"),
    Finding("TXF-I72", InputError, (), "query points or face indices are of the wrong kind or shape",
            "give points [M, 3] and, if any, one face index for each"),
    Finding("TXF-I90", InputError, (), "a side of a picture is not a whole number of pixels in 1..16384", "take another --size"),
    Finding("TXF-I91", InputError, (), "a direction or place of the camera is zero, not finite or not a triple",
            "move the camera"),
    Finding("TXF-I92", InputError, (), "the radius or the field of view is out of range", "take one that the message allows"),
    Finding("TXF-I93", InputError, (), "there is no view of this number", "count the views from 0"),
    Finding("TXF-I94", InputError, (), "no point of the surface is visible, so that nothing can be compared",
            "give the materials that the warnings name an alpha above 0"),
    Finding("TXF-I95", InputError, (), "no pixel of any view is covered by both sides", "compare versions of one asset"),
    Finding("TXF-I96", InputError, (), "LPIPS needs an optional extra", "pip install texfcodec[lpips]"),
    Finding("TXF-I97", InputError, (), "the file of AlexNet weights cannot be opened", "check the path"),
    Finding("TXF-I98", InputError, (), "the file does not hold the weights of torchvision's AlexNet",
            "give the state dict that torchvision publishes for it"),
    Finding("TXF-I99", InputError, (), "a rendered colour is not finite", "report the asset"),
    # Writing.
    Finding("TXF-O01", InputError, (), "the folder of the output does not exist", "make the folder, or check the path"),
    Finding("TXF-O02", InputError, (), "the output cannot be written there", "check the permissions, or name another place"),
    Finding("TXF-O03", InputError, (), "the disk is full", "free space, or name another disk"),
    Finding("TXF-O04", InputError, (), "the operating system refused the output", "look up the reason that is given"),
    Finding("TXF-O05", InputError, (), "the output's suffix names no known format", "take .glb, .gltf, .obj, .ply or .npz"),
    Finding("TXF-O06", InputError, (), "the appearance is not known", "take texture, vertex or voxels"),
    Finding("TXF-O07", InputError, (), "the output would replace a file that was read", "name another output"),
    Finding("TXF-O08", InputError, (), "a file beside the output is there already and was not named",
            "give --overwrite, or name another output"),
    Finding("TXF-O10", InputError, (), "atlas method or texture size are unknown, or the atlas is of another mesh",
            "take a method and a size that save() allows"),
    Finding("TXF-O11", InputError, (), "an atlas is asked for a mesh with broken faces or coordinates", "repair the mesh"),
    Finding("TXF-O12", InputError, (), "the mesh has too many separate pieces for one atlas",
            "write --appearance vertex or voxels"),
    Finding("TXF-O13", InputError, (), "voxels are asked for, and every field of the stream is over texels",
            "write --appearance texture or vertex"),
    Finding("TXF-O14", InputError, (),
            "texture format, its quality or the mesh compression are unknown, or do not go with what is written",
            "take what the message allows"),
    Finding("TXF-O15", SupportError, (), "the texture format or compression needs a package that is not installed",
            "pip install \"texfcodec[formats]\""),
    Finding("TXF-O16", InputError, (), "two assets of a batch would become the same stream",
            "rename one, or name its stream in a manifest"),
    Finding("TXF-O17", InputError, (), "another run is at work in the folder for results",
            "wait for its end, or name another folder"),
    Finding("TXF-O18", InputError, (), "a stream is to be carried by something else than a GLB or glTF",
            "name an output that ends in .glb or .gltf"),
    # Command lines.
    Finding("TXF-C01", None, (), "the command line is wrong", "see --help of the tool", EXIT_USAGE),
    Finding("TXF-C02", None, (), "the command was interrupted; no file is half-written", "start it again", EXIT_INTERRUPTED),
    Finding("TXF-C03", InputError, (), "nobody reads the output any more", "look at the next command of the pipe"),
    Finding("TXF-C04", None, (), "internal error", "set TEXF_TRACEBACK=1, run it again and report what is shown", EXIT_INTERNAL),
    Finding("TXF-C05", InputError, (), "no Dask scheduler answers, or it is gone", "check the address, and start the cluster"),
    Finding("TXF-C06", InputError, (), "the client of Dask clusters is not installed", "pip install \"texfcodec[cluster]\""),
    Finding("TXF-C07", SupportError, (), "the process that coded an asset of a batch ended without an answer",
            "code the asset alone, and report what is shown"),
    Finding("TXF-C08", InputError, (), "the page cannot be served at this port",
            "leave --port out, which takes any that is free"),
    Finding("TXF-C09", SupportError, (), "a browser is needed, and none is found",
            "install Chromium, or name a browser of its kind in TEXF_BROWSER"),
    Finding("TXF-C10", SupportError, (), "the browser ends or takes too long before the page has done its work",
            "try again on a machine that is less busy, or with another browser in TEXF_BROWSER"),
    Finding("TXF-C11", SupportError, (), "the page in the browser cannot do what was asked",
            "do what the message says, or take another browser"),
)
BY_CODE = {finding.code: finding for finding in FINDINGS}

"""Every code of the package in one table: the fault, its clauses in the specification, and the remedy. Most are errors;
texf-validate also warns of odd things in a valid stream, and notes those that cost bytes or are seldom intended.

The code that raises an error names it, too; a test compares both. bitstream_spec.md and docs/guide/errors.md contain this table
as generated blocks (`make -C tools spec-tables`).
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
    """One code.

    family: its class, or None if only the command lines report it and no exception carries it; clauses: those of
    bitstream_spec.md that are violated or at stake, each with the clauses below it; text: the fault; remedy: the user's next
    step; told_exit: exit code of a finding without family; severity: one of SEVERITIES, below error in a valid stream.
    """

    code: str
    family: type[TexfError] | None
    clauses: tuple[str, ...]
    text: str
    remedy: str
    told_exit: int | None = None
    severity: str = ERROR

    @property
    def family_name(self) -> str:
        return COMMAND_LINE if self.family is None else self.family.__name__

    @property
    def exit_code(self) -> int | None:
        return self.told_exit if self.family is None else self.family.exit_code

    def covers(self, clause: str) -> bool:
        """Return whether a clause such as "5.7.1" is one of the finding's, or below one of them."""
        return any(clause == own or clause.startswith(own + ".") for own in self.clauses)


_REPAIR = "get a new copy of the file, or report the fault to the authors of its encoder"
_EXPORT = "repair the mesh in the tool that wrote it, and export it again"
_ENCODER = "report this to the authors of the encoder"


def _warning(code, clause, text, remedy):
    return Finding(code, None, (clause,), text, remedy, EXIT_OK, WARNING)


def _note(code, clause, text, remedy):
    return Finding(code, None, (clause,), text, remedy, EXIT_OK, NOTE)


FINDINGS = (
    # The stream is invalid.
    Finding("TXF-S01", StreamError, ("5.1",), "the file does not start with the TexF signature", "check that it is a .texf file"),
    Finding("TXF-S02", StreamError, ("5",), "the data ends inside an element or a unit", "download or copy the whole file again"),
    Finding("TXF-S03", StreamError, ("5.2",), "the checksum of a unit does not match", "download or copy the file again"),
    Finding("TXF-S04", StreamError, ("5",), "a value is out of its range", _REPAIR),
    Finding("TXF-S05", StreamError, ("4.3",), "a variable-length number is not in its shortest form", _REPAIR),
    Finding("TXF-S06", StreamError, ("5",), "a text is not valid UTF-8", _REPAIR),
    Finding("TXF-S07", StreamError, ("5.2",), "a unit is missing, out of order or repeated", _REPAIR),
    Finding("TXF-S08", StreamError, ("5.2", "5.9"), "a unit has unused bytes, or bytes follow the end unit",
            "remove the bytes after the stream, or get a new copy of the file"),
    Finding("TXF-S09", StreamError, ("5.6", "5.7"), "a unit refers to a field, channel group or material that does not exist",
            _REPAIR),
    Finding("TXF-S10", StreamError, ("5.7.2", "5.7.4"), "the lengths in an attribute unit do not add up to its data", _REPAIR),
    Finding("TXF-S11", StreamError, ("5.2", "5.4", "5.5", "5.6", "5.7", "5.10"),
            "the units differ from those that the sequence header and the materials announce",
            _REPAIR),
    Finding("TXF-S12", StreamError, ("5.7.1",), "a slice begins past the last node", _REPAIR),
    Finding("TXF-S13", StreamError, ("5.7",), "one attribute unit codes all fields, but a field is over texels", _REPAIR),
    Finding("TXF-S14", StreamError, ("5.3.1", "5.4.1"), "the materials and channel groups of the stream do not match", _REPAIR),
    Finding("TXF-S20", StreamError, ("5.6",), "the Draco data is not an edgebreaker mesh of version 2.2", _REPAIR),
    Finding("TXF-S21", StreamError, ("5.6",), "the counts in the Draco data differ from those of their unit", _REPAIR),
    Finding("TXF-S22", StreamError, ("5.6",), "the Draco data cannot be decoded", _REPAIR),
    Finding("TXF-S23", StreamError, ("5.6",), "the Draco data has an index, a position or a UV out of range", _REPAIR),
    Finding("TXF-S24", StreamError, ("5.6.3",), "the checksum of the decoded faces does not match", _REPAIR),
    Finding("TXF-S30", StreamError, ("6.4", "6.5", "8.4.2", "8.4.3", "11.3"),
            "the voxels, texels, edges or corners rebuilt from the geometry differ from the coded ones",
            _REPAIR),
    Finding("TXF-S32", StreamError, ("7.10", "8.4.2", "8.4.4", "11.8"), "the checksum of the decoded values does not match",
            _REPAIR),
    Finding("TXF-S40", StreamError, (), "the sandbox of --isolate crashed on the stream, or returned an invalid result",
            "do not trust the file; raise --limit isolate-bytes, and if that does not help, report it as in SECURITY.md"),
    Finding("TXF-S50", StreamError, ("5.7.4",), "a network parameter is NaN, infinite or of magnitude 2^12 or more", _REPAIR),
    # Valid, but not supported.
    Finding("TXF-U01", SupportError, ("5.2",), "the stream has a critical unit that this version does not know",
            "decode with a newer version"),
    Finding("TXF-U02", SupportError, ("5.7",), "the stream has an attribute codec that this version does not know",
            "decode with a newer version"),
    Finding("TXF-U03", SupportError, ("5.3.1",), "a channel group has a number of components that this version does not know",
            "decode with a newer version"),
    Finding("TXF-U04", SupportError, ("5.3",), "the stream is of another version of the format",
            "decode with the version that wrote it"),
    Finding("TXF-U06", SupportError, (), "no codec of this name is installed", "install its plug-in, or choose another codec"),
    Finding("TXF-U07", SupportError, ("5.7",), "the stream needs a codec that is not installed", "install its plug-in"),
    Finding("TXF-U08", SupportError, (), "the codec of a plug-in cannot be loaded, or its class, name or id is invalid",
            "repair, update or remove the plug-in"),
    Finding("TXF-U09", SupportError, ("4.3",), "an element has a value that this version does not know",
            "decode with a newer version"),
    Finding("TXF-U10", SupportError, (), "the engine of --engine cannot decode this stream, or is not installed",
            "omit --engine, install wasmtime, or run make native"),
    Finding("TXF-U11", SupportError, (), "the page of texf-view does not support plug-in codecs",
            "convert the stream to a GLB with texf-dec, and show the GLB"),
    # Over a limit; every limit is a flag of the tools and a field of Limits.
    Finding("TXF-L01", LimitError, ("10",), "the stream is larger than the limit",
            "raise --limit file-bytes if you trust the file"),
    Finding("TXF-L02", LimitError, ("5.6",), "the stream or mesh has more vertices than the limit allows",
            "raise --limit vertices, or simplify the mesh"),
    Finding("TXF-L03", LimitError, ("5.6",), "the stream or mesh has more faces than the limit allows",
            "raise --limit faces, or simplify the mesh"),
    Finding("TXF-L04", LimitError, ("5.5", "6.3", "6.5"), "the fields have more voxels and texels than the limit allows",
            "raise --limit voxels, or encode with a smaller --resolution or --texel-size"),
    Finding("TXF-L05", LimitError, ("6.3", "6.5"), "the fields need more samples and rows of the surface than the limit allows",
            "raise --limit samples, or encode with a smaller --resolution or --texel-size"),
    Finding("TXF-L06", LimitError, ("5.8",), "the metadata unit is larger than the limit", "raise --limit metadata-bytes"),
    Finding("TXF-L07", LimitError, (), "decoding needs more memory than the limit of the sandbox of --isolate",
            "raise --limit isolate-bytes if you trust the file"),
    Finding("TXF-L08", LimitError, (), "decoding takes longer than the time limit of the sandbox of --isolate",
            "raise --limit isolate-seconds if you trust the file"),
    Finding("TXF-L09", None, (), "there is not enough memory",
            "free memory, encode with a smaller --resolution, or decode with a larger --lod", EXIT_LIMIT),
    Finding("TXF-L10", LimitError, ("5.7.4",), "the payload has more latents than the limit allows", "raise --limit latents"),
    Finding("TXF-L11", LimitError, ("5.5",), "an image has more texels than the limit allows",
            "raise --limit texels, or encode with a smaller --texel-size"),
    Finding("TXF-L12", LimitError, (), "encoding an asset of a batch takes longer than the limit allows",
            "raise --limit-seconds"),
    Finding("TXF-L13", LimitError, (), "an asset is too large to be sent to workers without access to its folder",
            "give the workers access to the folder"),
    Finding("TXF-L14", LimitError, (), "the stream has more units than texf-validate can check",
            "decode it with texf-dec, which has no such limit"),
    Finding("TXF-L15", LimitError, (), "the system cannot start a child process for --isolate, or has no space for its files",
            "free space for temporary files, or end other processes"),
    # Valid and odd; texf-validate says so.
    _warning("TXF-W01", "5.2", "an ancillary unit has a type that this version does not know, and is skipped",
             "decode with a newer version if you need its content"),
    _warning("TXF-W02", "5.8", "the metadata is not a JSON object, and is skipped", _ENCODER),
    _warning("TXF-W03", "5.6", "the Draco data continues after the end of its mesh",
             "remove the extra data unless an application uses it; " + _ENCODER),
    _warning("TXF-W04", "5.7", "the stream needs a plug-in codec, which other decoders do not have",
             "encode with a codec of the specification for other decoders"),
    _warning("TXF-W05", "7.6.2", "a codeword continues after its last symbol", "remove the extra bytes; " + _ENCODER),
    _warning("TXF-W06", "5.7.2", "the byte counts by level differ from what a decoder reads",
             "do not use them to load coarse levels alone; " + _ENCODER),
    _warning("TXF-W07", "12", "a name has control characters, which can corrupt the display of a terminal",
             "rename the material in the source, and encode it again"),
    _note("TXF-W08", "12", "a name has a path separator, or refers to a parent folder",
          "do not use the name unchanged as a file name"),
    _note("TXF-W09", "5.4.1", "several materials have the same name",
          "rename them in the source if an application tells them apart by name"),
    _note("TXF-W10", "5.6", "a material has no geometry unit", "remove the material from the source"),
    _note("TXF-W11", "5.4.1", "a material names channels that none of its effects reads",
          "remove the maps, or set the factors that make them visible"),
    _note("TXF-W12", "5.3.1", "alpha is coded, but every material is opaque", "remove alpha from the source"),
    _note("TXF-W13", "5.4.1", "alpha_cutoff of a masked material is 0, which has no effect", "make the material opaque"),
    _note("TXF-W14", "5.6", "several geometry units have the same field and material",
          "code them as a single unit, which takes fewer bytes"),
    _note("TXF-W15", "5.6", "some faces have no area", "remove them, or encode with more --position-bits"),
    _note("TXF-W16", "5.6", "some faces are repeated, with the same corners in the same order",
          "remove the copies; a viewer may show any of them"),
    _note("TXF-W17", "5.3", "the positions use half of the lattice or less along every axis",
          "fit origin and side to the mesh; its positions are coarser than necessary"),
    _warning("TXF-W18", "5.3", "side is 0 though there are faces, so all faces collapse to one point", _ENCODER),
    _note("TXF-W19", "5.5", "a field has one voxel or texel, so its whole surface has one colour",
          "encode with a larger --resolution if it should have more colours"),
    _note("TXF-W20", "5.5", "the surface uses less than a sixteenth of a field's image",
          "crop or pack the image; a decoder allocates memory for all of it"),
    _note("TXF-W21", "5.7", "level_shift reduces a plane to one cell, but the field has several",
          "code a constant (codec 2), or a factor"),
    _note("TXF-W22", "5.3", "the stream is an empty mesh", "check that the encoder read the right file"),
    _note("TXF-W23", "5.5", "a field has more voxels per side than the position lattice has steps",
          "encode with a smaller --resolution or more --position-bits"),
    # Loading.
    Finding("TXF-I01", InputError, (), "the input does not exist", "check the path"),
    Finding("TXF-I02", InputError, (), "the input is a directory", "specify a file"),
    Finding("TXF-I03", InputError, (), "the input cannot be read", "check the file's permissions and its disk"),
    Finding("TXF-I04", InputError, (), "the input is empty", "download or export the file again"),
    Finding("TXF-I05", InputError, (),
            "the suffix does not belong to a supported format, or the type of the object is not supported",
            "convert it to one of the formats of docs/guide/formats.md"),
    Finding("TXF-I06", InputError, (), "the content of the file does not match its suffix",
            "rename the file with the suffix of its format"),
    Finding("TXF-I07", InputError, (), "the GLB container is truncated or broken", "download or export the file again"),
    Finding("TXF-I08", InputError, (), "the glTF text is not JSON", _EXPORT),
    Finding("TXF-I09", InputError, (),
            "the glTF structure is malformed: it has a wrong type, a missing property or an invalid reference",
            "locate the fault with the Khronos glTF validator, and export the file again"),
    Finding("TXF-I10", InputError, (), "a glTF buffer is missing, unreadable or too short", "put the .bin file beside the .gltf"),
    Finding("TXF-I11", InputError, (), "an accessor or bufferView exceeds its buffer", _EXPORT),
    Finding("TXF-I12", InputError, (), "the Draco data of a glTF primitive is broken", _EXPORT),
    Finding("TXF-I13", InputError, (), "a face refers to a vertex or texture coordinate that does not exist", _EXPORT),
    Finding("TXF-I14", InputError, (), "a position, UV, colour or factor in use is NaN or infinite", _EXPORT),
    Finding("TXF-I15", InputError, (), "the input has no triangles", "specify a mesh; point clouds and lines are not supported"),
    Finding("TXF-I16", InputError, (), "a texture or material file is missing (a warning unless --strict)",
            "put the file at the path that the mesh names"),
    Finding("TXF-I17", InputError, (), "an image cannot be decoded (a warning unless --strict)", "save the image again as PNG"),
    Finding("TXF-I18", InputError, (), "texture coordinates are NaN or infinite (a warning unless --strict)", _EXPORT),
    Finding("TXF-I19", InputError, (), "the glTF node graph is not a tree", _EXPORT),
    Finding("TXF-I20", InputError, (), "a line of the OBJ or MTL file cannot be read", "correct the line that the message names"),
    Finding("TXF-I21", InputError, (), "the PLY file is malformed or ends early", _EXPORT),
    Finding("TXF-I22", InputError, (), "the arrays of a mesh object do not match", "check them against the docstring of Scene"),
    Finding("TXF-I23", InputError, (), "the STL or OFF file is malformed or ends early", _EXPORT),
    Finding("TXF-I24", InputError, (), "the 3MF or COLLADA file is not a valid archive or XML document", _EXPORT),
    Finding("TXF-I25", InputError, (),
            "the stream in a GLB or glTF cannot be decoded; its fallback is read (a warning unless --strict)",
            "write the file again with texf-dec --carry-stream, or use a newer version"),
    Finding("TXF-I26", InputError, (), "a GLB was given as a stream but does not carry one",
            "encode it with texf-enc; texf-dec --carry-stream writes a GLB that carries its stream"),
    Finding("TXF-I27", InputError, (), "a file that the mesh names is remote (a warning unless --strict)",
            "download it, and put it at a path that the mesh names"),
    Finding("TXF-I28", InputError, (), "a texture has no image in a supported format (a warning unless --strict)",
            "export its image as PNG, JPEG, WebP or AVIF"),
    Finding("TXF-I29", InputError, (), "the file has no animation, or none of this name or number, to pose it by",
            "omit --time, or choose an animation that the message lists"),
    Finding("TXF-I30", SupportError, (),
            "the file is compressed by a form of meshopt that is not supported, or not without a package",
            'run pip install "texfcodec[formats]", or decompress it, e.g. with glTF-Transform'),
    Finding("TXF-I31", SupportError, (), "the file requires an extension that is not supported",
            "export it without the extension"),
    Finding("TXF-I32", SupportError, (), "an image is a KTX2 texture, but the package that reads it is not installed",
            'run pip install "texfcodec[formats]", or export the image as PNG, JPEG, WebP or AVIF'),
    Finding("TXF-I33", SupportError, (), "the glTF version of the file is not 2", "convert it to glTF 2"),
    Finding("TXF-I34", SupportError, (), "the mesh is compressed with Draco, but DracoPy is not installed",
            "run pip install DracoPy"),
    Finding("TXF-I35", SupportError, (), "the format requires a package that is not installed",
            'run pip install "texfcodec[formats]"'),
    Finding("TXF-I40", LimitError, (), "an image has more pixels than the limit allows",
            "raise --limit image-pixels, or make the image smaller; decoders of its texels need a higher --limit texels too"),
    Finding("TXF-I41", LimitError, (), "the mesh has too many faces or elements, or there is not enough memory",
            "simplify the mesh"),
    Finding("TXF-I42", InputError, (), "an .npz or .vxz file is broken, holds pickled objects, or misstates its sizes",
            "write it again with numpy.savez or with o_voxel"),
    Finding("TXF-I43", InputError, (), "the voxels come without a surface",
            "add vertices and faces, as docs/guide/generated_mesh.md shows"),
    Finding("TXF-I44", InputError, (), "arrays of a surface or of voxels do not fit together, or voxels are outside the cube",
            "check them against docs/guide/generated_mesh.md"),
    Finding("TXF-I45", InputError, (), "a function of points raised an exception or returned something else than values",
            "return a dict of arrays [n, C] by channel name"),
    # Encoding.
    Finding("TXF-I50", InputError, (), "an option is unknown, out of range or in conflict with another",
            "choose a value that the message allows"),
    Finding("TXF-I51", InputError, (), "no K and QP meet the target", "choose the best or allowed target in the message"),
    Finding("TXF-I52", InputError, (), "the mesh would lose something, and --strict forbids it",
            "fix the listed items in the mesh, or omit --strict"),
    Finding("TXF-I54", InputError, (), "the budget of resident bytes is too small for a grid of latents",
            "raise --resident-bytes"),
    Finding("TXF-I55", InputError, (), "the checkpoint belongs to another fit, or cannot be read",
            "specify another file, or delete the checkpoint and start again"),
    Finding("TXF-I56", InputError, (), "fitting with torch requires an optional extra", 'run pip install "texfcodec[ntc]"'),
    Finding("TXF-I57", InputError, (), "a batch contains no asset, or its manifest cannot be read",
            "check the manifest against texf-enc --help"),
    Finding("TXF-I58", InputError, (), "training diverged: the weights are NaN or infinite",
            "choose another --seed, or delete the checkpoint"),
    Finding("TXF-I60", InputError, (), "the mesh has coordinates that are too large", "scale the mesh down"),
    Finding("TXF-I61", InputError, (), "the mesh is too small to be scaled", "scale the mesh up"),
    Finding("TXF-I62", InputError, (), "Draco cannot code the mesh", "report the mesh"),
    Finding("TXF-I63", InputError, (), "no face has area", "encode with more --position-bits, or repair the mesh"),
    # Asking and measuring.
    Finding("TXF-I70", InputError, (), "an empty asset has no colour to query", "do not query a stream without faces"),
    Finding("TXF-I71", InputError, (), "query points are not finite", "remove such points"),
    Finding("TXF-I72", InputError, (), "query points or face indices are of the wrong kind or shape",
            "pass points of shape [M, 3] and, optionally, a face index for each"),
    Finding("TXF-I90", InputError, (), "a side of a picture is not an integer in 1..16384", "choose another --size"),
    Finding("TXF-I91", InputError, (), "a direction or position of the camera is zero, not finite or not a triple",
            "move the camera"),
    Finding("TXF-I92", InputError, (), "the radius or the field of view is out of range",
            "choose a value that the message allows"),
    Finding("TXF-I93", InputError, (), "the number of the view does not exist", "count the views from 0"),
    Finding("TXF-I94", InputError, (), "no point of the surface is visible, so nothing can be compared",
            "set an alpha above 0 in the materials that the warnings name"),
    Finding("TXF-I95", InputError, (), "no pixel of any view is covered by both sides", "compare two versions of the same asset"),
    Finding("TXF-I96", InputError, (), "LPIPS requires an optional extra", 'run pip install "texfcodec[lpips]"'),
    Finding("TXF-I97", InputError, (), "the file of AlexNet weights cannot be opened", "check the path"),
    Finding("TXF-I98", InputError, (), "the file does not contain the weights of torchvision's AlexNet",
            "use the state dict that torchvision publishes"),
    Finding("TXF-I99", InputError, (), "a rendered colour is not finite", "report the asset"),
    # Writing.
    Finding("TXF-O01", InputError, (), "the folder of the output does not exist", "create the folder, or check the path"),
    Finding("TXF-O02", InputError, (), "the output cannot be written", "check the permissions, or specify another path"),
    Finding("TXF-O03", InputError, (), "the disk is full", "free space, or specify another disk"),
    Finding("TXF-O04", InputError, (), "the operating system rejected the output", "see the reason in the message"),
    Finding("TXF-O05", InputError, (), "the suffix of the output does not belong to a known format",
            "use .glb, .gltf, .obj, .ply or .npz"),
    Finding("TXF-O06", InputError, (), "the appearance is unknown", "choose texture, vertex or voxels"),
    Finding("TXF-O07", InputError, (), "the output would overwrite an input file", "specify another output"),
    Finding("TXF-O08", InputError, (), "a file beside the output already exists", "add --overwrite, or specify another output"),
    Finding("TXF-O10", InputError, (), "the atlas method or texture size is unknown, or the atlas belongs to another mesh",
            "choose a method and a size that save() allows"),
    Finding("TXF-O11", InputError, (), "an atlas was requested for a mesh with broken faces or coordinates", "repair the mesh"),
    Finding("TXF-O12", InputError, (), "the mesh has too many separate pieces for one atlas",
            "use --appearance vertex or voxels"),
    Finding("TXF-O13", InputError, (), "voxels were requested, but every field of the stream is over texels",
            "use --appearance texture or vertex"),
    Finding("TXF-O14", InputError, (),
            "the texture format, its quality or the mesh compression is unknown or does not fit the output",
            "choose a value that the message allows"),
    Finding("TXF-O15", SupportError, (), "the texture format or compression requires a package that is not installed",
            'run pip install "texfcodec[formats]"'),
    Finding("TXF-O16", InputError, (), "a manifest gives two assets the same output name, or has one asset twice",
            "set another output name (out) in the manifest"),
    Finding("TXF-O17", InputError, (), "another run is using the results folder",
            "wait until it ends, or specify another folder"),
    Finding("TXF-O18", InputError, (), "only a GLB or glTF can carry a stream", "specify an output that ends in .glb or .gltf"),
    # Command lines.
    Finding("TXF-C01", None, (), "the command line is wrong", "see --help of the tool", EXIT_USAGE),
    Finding("TXF-C02", None, (), "the command was interrupted; no partial file remains", "start it again", EXIT_INTERRUPTED),
    Finding("TXF-C03", InputError, (), "the reader of the output closed the pipe", "check the next command of the pipe"),
    Finding("TXF-C04", None, (), "an internal error occurred",
            "set TEXF_TRACEBACK=1, run the command again and report the output", EXIT_INTERNAL),
    Finding("TXF-C05", InputError, (), "no Dask scheduler answers, or its connection was lost",
            "check the address, and start the cluster"),
    Finding("TXF-C06", InputError, (), "the client of Dask clusters is not installed", 'run pip install "texfcodec[cluster]"'),
    Finding("TXF-C07", SupportError, (), "the process that encoded an asset of a batch ended without a result",
            "encode the asset alone, and report the output"),
    Finding("TXF-C08", InputError, (), "the page cannot be served at this port", "omit --port to use any free port"),
)
BY_CODE = {finding.code: finding for finding in FINDINGS}

"""OBJ with MTL, PLY and COLLADA files in each of which one property is the only thing that shows: {property: Kind}."""

import numpy as np

from tools.proof.strangers.kinds_gltf import (
    COLOURS,
    FACES,
    NORMALS,
    POSITIONS,
    SIDE,
    TANGENTS,
    UVS,
    Kind,
    Texture,
    base,
    bumps,
    coloured,
    glb,
    picture,
)

QUADS = [[a, a + 1, a + SIDE + 1, a + SIDE] for row in range(SIDE - 1) for a in range(row * SIDE, row * SIDE + SIDE - 1)]
RED, WHITE = "newmtl m\nKd 0.9 0.1 0.1\n", "newmtl m\nKd 1 1 1\n"
MAPPED = "newmtl m\nKd 1 1 1\nmap_Kd a.png\n"
TWO = "newmtl m\nKd 1 1 1\nnewmtl n\nKd 0.1 0.2 0.9\n"


def _rows(word, values):
    return "".join(f"{word} {' '.join(f'{value:.6g}' for value in row)}\n" for row in values)


def obj(faces="{0}/{0}/{0}", head="mtllib a.mtl\n", use="usemtl m\n", colours=None, uvs=UVS, normals=NORMALS, between=""):
    """The patch as an OBJ file of quads. faces: of a corner, with {0} for its number from 1; between: lines in its middle."""
    positions = POSITIONS if colours is None else np.hstack([POSITIONS, colours])
    lines = ["f " + " ".join(faces.format(i + 1, i - len(POSITIONS)) for i in quad) + "\n" for quad in QUADS]
    half = len(lines) // 2
    flip = np.column_stack([uvs[:, 0], 1 - uvs[:, 1]])
    return (
        head
        + _rows("v", positions)
        + _rows("vt", flip)
        + _rows("vn", normals)
        + use
        + "".join(lines[:half])
        + between
        + "".join(lines[half:])
    ).encode()


def _mtl(with_it, without=WHITE, **files):
    """A Kind of a material file."""
    return Kind(
        {"model.obj": obj(), "a.mtl": with_it.encode(), **files}, {"model.obj": obj(), "a.mtl": without.encode(), **files}
    )


def _obj(with_it, without=None, mtl=MAPPED, like="three.js", expected=b"", **files):
    files = {"a.mtl": mtl.encode(), "a.png": picture(), **files}
    return Kind({"model.obj": with_it, **files}, {"model.obj": obj() if without is None else without, **files}, like, expected)


def obj_kinds():
    """{property: Kind}"""
    png, look = {"a.png": picture()}, glb(coloured())
    bump, tilted = {"b.png": bumps()}, NORMALS + [0.9, 0.5, 0]
    lit = glb(coloured(), {"NORMAL": NORMALS, "TEXCOORD_0": UVS})
    glossy = glb(base(metallicFactor=1.0, roughnessFactor=0.2))
    return {
        "Kd": _mtl(RED),
        "map_Kd": _mtl(MAPPED, **png),
        "Kd times map_Kd": _mtl(RED + "map_Kd a.png\n", MAPPED, **png),
        "map_Kd -s": _mtl(WHITE + "map_Kd -s 2 3 1 a.png\n", MAPPED, **png),
        "map_Kd -o": _mtl(WHITE + "map_Kd -o 0.4 0.2 0 a.png\n", MAPPED, **png),
        "map_Kd name with spaces": _mtl(WHITE + "map_Kd a b.png\n", **{"a b.png": picture()}),
        "map_Kd in a folder": _mtl(WHITE + "map_Kd maps/a.png\n", **{"maps/a.png": picture()}),
        "map_Kd with backslashes": _named("map_Kd maps\\a.png\n", {"maps/a.png": picture()}, look),
        "map_Kd of other case": _named("map_Kd A.PNG\n", png, look),
        "map_Kd absolute elsewhere": _named("map_Kd C:\\job\\a.png\n", png, look),
        "map_Kd as JPEG": _mtl(WHITE + "map_Kd a.jpg\n", **{"a.jpg": picture("JPEG", quality=95)}),
        "map_Kd as TGA": _mtl(WHITE + "map_Kd a.tga\n", **{"a.tga": picture("TGA")}),
        "map_Kd as BMP": _mtl(WHITE + "map_Kd a.bmp\n", **{"a.bmp": picture("BMP")}),
        "map_Ka alone": Kind(
            {"model.obj": obj(), "a.mtl": (WHITE + "map_Ka a.png\n").encode(), **png},
            {"model.obj": obj(), "a.mtl": WHITE.encode()},
            "construction",
            look,
        ),
        "d": _mtl("newmtl m\nKd 1 0 0\nd 0.3\n", "newmtl m\nKd 1 0 0\n"),
        "Tr": _mtl("newmtl m\nKd 1 0 0\nTr 0.7\n", "newmtl m\nKd 1 0 0\n"),
        "map_d": _mtl(MAPPED + "map_d d.png\n", MAPPED, **png, **{"d.png": picture(mode="L")}),
        "Ke": _mtl(RED + "Ke 0.2 0.6 0.9\n", RED),
        "map_Ke": _mtl(RED + "Ke 1 1 1\nmap_Ke a.png\n", RED, **png),
        "norm": _bumped("norm b.png\n", bump),
        "map_Bump of a normal map": _bumped("map_Bump -bm 1 b.png\n", bump),
        "map_Bump of heights": _mtl(WHITE + "map_Bump -bm 4 h.png\n", **{"h.png": bumps("PNG", "heights")}),
        "Pm and Pr": Kind(
            {"model.obj": obj(), "a.mtl": (WHITE + "Pm 1\nPr 0.2\n").encode()},
            {"model.glb": glb(base())},
            "construction",
            glossy,
        ),
        "mtllib with spaces": _obj(obj(head="mtllib a b.mtl\n"), obj(head=""), **{"a b.mtl": MAPPED.encode()}),
        "mtllib twice": _obj(obj(head="mtllib n.mtl\nmtllib a.mtl\n"), obj(head=""), **{"n.mtl": b"newmtl n\nKd 0 0 1\n"}),
        "mtllib of two names": _obj(
            obj(head="mtllib n.mtl a.mtl\n"),
            obj(head=""),
            like="construction",
            expected=look,
            **{"n.mtl": b"newmtl n\nKd 0 0 1\n"},
        ),
        "usemtl in between": _obj(obj(between="usemtl n\n"), obj(), TWO),
        "o and g in between": _obj(obj(between="o x\ng y\nusemtl n\n"), obj(), TWO),
        "newmtl with spaces": _obj(obj(use="usemtl m 1\n"), obj(use=""), "newmtl m 1\nKd 0.9 0.1 0.1\n"),
        "v with colours": _obj(obj(colours=COLOURS, use=""), obj(use="")),
        "v with colours of 0 to 255": _obj(
            obj(colours=np.round(COLOURS * 255), use=""),
            obj(use=""),
            like="construction",
            expected=glb(base(), {"NORMAL": NORMALS, "TEXCOORD_0": UVS, "COLOR_0": _linear(COLOURS)}),
        ),
        "#MRGB of ZBrush": _obj(
            obj(use="") + _mrgb(),
            obj(use=""),
            like="construction",
            expected=glb(base(), {"NORMAL": NORMALS, "TEXCOORD_0": UVS, "COLOR_0": _linear(COLOURS)}),
        ),
        "vn": _obj(obj(normals=tilted), mtl=WHITE),
        "negative indices": _obj(obj("{1}/{1}/{1}"), obj(use="")),
        "f with vn alone": _obj(obj("{0}//{0}", normals=tilted), obj("{0}//{0}"), WHITE),
        "polygon of five corners": _obj(obj(between="f 1/1/1 13/13/13 169/169/169 163/163/163 157/157/157\n")),
        "lines joined by a backslash": _obj(obj().replace(b"f 1/1/1 2/2/2", b"f 1/1/1 \\\n2/2/2"), obj(use="")),
        "ends of lines of Windows": Kind(
            {"model.obj": obj().replace(b"\n", b"\r\n"), "a.mtl": MAPPED.replace("\n", "\r\n").encode(), **png},
            {"model.obj": obj(), "a.mtl": WHITE.encode()},
        ),
        "byte order mark": _obj(b"\xef\xbb\xbf" + obj(), obj(use=""), like="construction", expected=lit),
        "tabs in MTL": Kind(
            {"model.obj": obj(), "a.mtl": b"newmtl m\n\tKd\t0.9 0.1 0.1\n"},
            {"model.obj": obj(), "a.mtl": WHITE.encode()},
            "construction",
            glb(base(baseColorFactor=[*_linear(np.array([0.9, 0.1, 0.1])).tolist(), 1])),
        ),
    }


def _bumped(line, files):
    """A Kind of a normal map, in tangent frames of its own: three.js makes up others where a file has none."""
    framed = {"NORMAL": NORMALS, "TEXCOORD_0": UVS, "TANGENT": TANGENTS}
    look = glb({**base(), "normalTexture": Texture(bumps())}, framed)
    mtl = {"model.obj": obj(), "a.mtl": (WHITE + line).encode(), **files}
    return Kind(mtl, {"model.obj": obj(), "a.mtl": WHITE.encode()}, "construction", look)


def _named(line, files, look):
    """A Kind of a file that tools find under a name that is not quite its own."""
    mtl = {"model.obj": obj(), "a.mtl": (WHITE + line).encode(), **files}
    return Kind(mtl, {"model.obj": obj(), "a.mtl": WHITE.encode()}, "construction", look)


def _linear(colours):
    return np.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4).astype(np.float32)


def _mrgb():
    words = "".join("ff" + "".join(f"{round(255 * value):02x}" for value in row) for row in COLOURS)
    return "".join(f"#MRGB {words[i : i + 512]}\n" for i in range(0, len(words), 512)).encode()


# PLY


def ply(columns, form="ascii", faces=None, face="property list uchar int vertex_indices", comment=""):
    """The patch as a PLY file. columns: [(names of properties, type, (n, .) array)] of vertices; faces: rows, each a list of
    lists or scalars in the order of `face`, which is their properties."""
    faces = [[quad] for quad in QUADS] if faces is None else faces
    kinds = {"float": "f4", "double": "f8", "uchar": "u1", "ushort": "u2", "int": "i4", "char": "i1", "short": "i2"}
    names = "".join(f"property {of} {name}\n" for words, of, _ in columns for name in words.split())
    element = "tristrips" if "tristrips" in face else "face"
    face = face.removeprefix("tristrips: ")
    head = (
        f"ply\nformat {form} 1.0\n{comment}element vertex {len(POSITIONS)}\n{names}element {element} {len(faces)}\n{face}\n"
        "end_header\n"
    ).encode()
    if form == "ascii":
        rows = np.hstack([values.astype(float) for _, _, values in columns])
        lines = [" ".join(f"{value:.7g}" for value in row) for row in rows]
        lines += [
            " ".join(str(word) for part in row for word in ((len(part), *part) if isinstance(part, list) else (part,)))
            for row in faces
        ]
        return head + ("\n".join(lines) + "\n").encode()
    order = "<" if "little" in form else ">"
    parts = [np.ascontiguousarray(values, order + kinds[of]).view(np.uint8).reshape(len(values), -1) for _, of, values in columns]
    types = [line.split() for line in face.split("\n")]
    body = b"".join(_binary(part, words, order, kinds) for row in faces for part, words in zip(row, types, strict=True))
    return head + np.hstack(parts).tobytes() + body


def _binary(part, words, order, kinds):
    if words[1] != "list":
        return np.array(part, order + kinds[words[1]]).tobytes()
    return np.array(len(part), order + kinds[words[2]]).tobytes() + np.array(part, order + kinds[words[3]]).tobytes()


XYZ, NXYZ, ST = (
    ("x y z", "float", POSITIONS),
    ("nx ny nz", "float", NORMALS),
    ("s t", "float", np.column_stack([UVS[:, 0], 1 - UVS[:, 1]])),
)
BYTES = np.round(COLOURS * 255)
RGB = ("red green blue", "uchar", BYTES)


def ply_kinds():
    """{property: Kind}"""
    alpha = np.round(60 + 190 * UVS[:, :1])
    tilted = (NORMALS + [0.9, 0.5, 0]) / np.linalg.norm(NORMALS + [0.9, 0.5, 0], axis=1, keepdims=True)
    shown = glb(base(), {"NORMAL": NORMALS, "COLOR_0": _linear(BYTES / 255)})
    clear = glb(
        {**base(), "alphaMode": "BLEND"},
        {"NORMAL": NORMALS, "COLOR_0": np.hstack([_linear(BYTES / 255), alpha / 255]).astype(np.float32)},
    )
    look, faced = glb(coloured()), glb(base(), {"NORMAL": NORMALS})
    strip = [
        index for row in range(SIDE - 1) for index in ([SIDE * (row + (i + 1) % 2) + i // 2 for i in range(2 * SIDE)] + [-1])
    ]
    wedges = [[quad, [float(x) for corner in quad for x in (UVS[corner, 0], 1 - UVS[corner, 1])]] for quad in QUADS]
    textured = {"comment": "comment TextureFile a.png\n"}
    tinted = [[quad, *(int(value) for value in BYTES[quad[0]])] for quad in QUADS]
    by_face = "property list uchar int vertex_indices\nproperty uchar red\nproperty uchar green\nproperty uchar blue"
    base_ply = ply([XYZ, NXYZ])

    def row(data, like="three.js", expected=b"", without=base_ply, **files):
        return Kind({"model.ply": data, **files}, {"model.ply": without, **files}, like, expected)

    png = {"a.png": picture()}
    return {
        "red green blue": row(ply([XYZ, NXYZ, RGB])),
        "diffuse_red": row(ply([XYZ, NXYZ, ("diffuse_red diffuse_green diffuse_blue", "uchar", BYTES)])),
        "r g b": row(ply([XYZ, NXYZ, ("r g b", "uchar", BYTES)])),
        "colours as floats": row(ply([XYZ, NXYZ, ("red green blue", "float", COLOURS)]), "construction", shown),
        "colours as ushorts": row(ply([XYZ, NXYZ, ("red green blue", "ushort", COLOURS * 65535)]), "construction", shown),
        "alpha": row(ply([XYZ, NXYZ, RGB, ("alpha", "uchar", alpha)]), "construction", clear, ply([XYZ, NXYZ, RGB])),
        "little endian": row(ply([XYZ, NXYZ, RGB], "binary_little_endian")),
        "big endian": row(ply([XYZ, NXYZ, RGB], "binary_big_endian")),
        "doubles": row(ply([("x y z", "double", POSITIONS), NXYZ, RGB], "binary_little_endian")),
        "other properties between": row(
            ply([XYZ, ("quality", "float", UVS[:, :1]), NXYZ, ("flags", "int", UVS[:, :1]), RGB], "binary_little_endian")
        ),
        "vertex_index": row(ply([XYZ, NXYZ, RGB], face="property list uchar int vertex_index")),
        "indices as uints of an int count": row(
            ply([XYZ, NXYZ, RGB], "binary_little_endian", face="property list int int vertex_indices")
        ),
        "nx ny nz": row(ply([XYZ, ("nx ny nz", "float", tilted)])),
        "tristrips": row(
            ply([XYZ, NXYZ, RGB], "binary_little_endian", [[strip]], "tristrips: property list int int vertex_indices"),
            "construction",
            shown,
        ),
        "colours of faces": row(ply([XYZ, NXYZ], faces=tinted, face=by_face), "construction", _by_face(tinted), base_ply),
        "TextureFile, s t": row(ply([XYZ, NXYZ, ST], **textured), "construction", look, **png),
        "TextureFile and texture_u": row(
            ply([XYZ, NXYZ, ("texture_u texture_v", ST[1], ST[2])], **textured), "construction", look, **png
        ),
        "TextureFile and u v": row(ply([XYZ, NXYZ, ("u v", ST[1], ST[2])], **textured), "construction", look, **png),
        "texcoord of faces": row(
            ply(
                [XYZ, NXYZ],
                faces=wedges,
                face="property list uchar int vertex_indices\nproperty list uchar float texcoord",
                **textured,
            ),
            "construction",
            look,
            **png,
        ),
        "quads": row(base_ply, "construction", faced, ply([XYZ, NXYZ], faces=[[quad[:3]] for quad in QUADS])),
    }


def _by_face(tinted):
    """A GLB whose faces have colours of their own."""
    corners = np.array([[quad[i] for i in (0, 1, 2, 0, 2, 3)] for quad, *_ in tinted]).ravel()
    colours = np.repeat(_linear(np.array([rgb for _, *rgb in tinted]) / 255), 6, axis=0).astype(np.float32)
    return glb(base(), {"NORMAL": NORMALS[corners], "COLOR_0": colours}, faces=None, positions=POSITIONS[corners])


# COLLADA

IMAGE = '<library_images><image id="i"><init_from>{}</init_from></image></library_images>'
SAMPLED = (
    '<newparam sid="f"><surface type="2D"><init_from>i</init_from></surface></newparam>'
    '<newparam sid="s"><sampler2D><source>f</source>{}</sampler2D></newparam>'
)
MAP = '<diffuse><texture texture="s" texcoord="UV"/></diffuse>'


def _colour(text):
    return f"<diffuse><color>{text}</color></diffuse>"


WHITE_LOOK = _colour("1 1 1 1")


def _source(name, values, words):
    params = "".join(f'<param name="{word}" type="float"/>' for word in words)
    return (
        f'<source id="{name}"><float_array id="{name}-a" count="{values.size}">{" ".join(f"{v:.6g}" for v in values.ravel())}'
        f'</float_array><technique_common><accessor source="#{name}-a" count="{len(values)}" stride="{len(words)}">{params}'
        "</accessor></technique_common></source>"
    )


def dae(look=WHITE_LOOK, shading="lambert", asset="<up_axis>Y_UP</up_axis>", images="", params="", node="", after="", **more):
    """The patch as a COLLADA file. more: extra (of the profile), colours, normals, uv_set, bind, shape (of the triangles)."""
    uvs, normals = more.get("uvs", UVS), more.get("normals", NORMALS)
    flip = np.column_stack([uvs[:, 0], 1 - uvs[:, 1]])
    sources = _source("p", POSITIONS, "XYZ") + _source("n", normals, "XYZ") + _source("t", flip, "ST")
    inputs = (
        '<input semantic="VERTEX" source="#v" offset="0"/><input semantic="NORMAL" source="#n" offset="0"/>'
        f'<input semantic="TEXCOORD" source="#t" offset="0" set="{more.get("uv_set", 0)}"/>'
    )
    if "colours" in more:
        sources += _source("c", more["colours"], "RGBA"[: more["colours"].shape[1]])
        inputs += '<input semantic="COLOR" source="#c" offset="0" set="0"/>'
    shape = more.get("shape", "triangles")
    bind = more.get("bind", '<bind_vertex_input semantic="UV" input_semantic="TEXCOORD" input_set="0"/>')
    geometry = (
        f'<geometry id="g"><mesh>{sources}<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>'
        f"{_primitives(shape, inputs)}</mesh></geometry>"
    )
    instance = (
        f'<instance_geometry url="#g"><bind_material><technique_common><instance_material symbol="sym" target="#m">{bind}'
        "</instance_material></technique_common></bind_material></instance_geometry>"
    )
    return (
        '<?xml version="1.0" encoding="utf-8"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">'
        f'<asset>{asset}</asset>{images}<library_effects><effect id="e"><profile_COMMON>{params}<technique sid="c"><{shading}>'
        f"{look}"
        f"</{shading}></technique>{more.get('extra', '')}</profile_COMMON></effect></library_effects>"
        '<library_materials><material id="m"><instance_effect url="#e"/></material></library_materials>'
        f"<library_geometries>{geometry}</library_geometries>{more.get('library', '')}"
        f'<library_visual_scenes><visual_scene id="s"><node>{node}{more.get("instance", instance)}</node>{after}</visual_scene>'
        '</library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>'
    ).encode()


INSTANCE = (
    '<instance_geometry url="#g"><bind_material><technique_common><instance_material symbol="sym" target="#m"/>'
    "</technique_common></bind_material></instance_geometry>"
)


def _primitives(shape, inputs):
    if shape == "triangles":
        return f'<triangles count="{len(FACES)}" material="sym">{inputs}<p>{" ".join(map(str, FACES.ravel()))}</p></triangles>'
    indices = " ".join(str(i) for quad in QUADS for i in quad)
    if shape == "polylist":
        counts = f"<vcount>{'4 ' * len(QUADS)}</vcount>"
        return f'<polylist count="{len(QUADS)}" material="sym">{inputs}{counts}<p>{indices}</p></polylist>'
    if shape == "polygons":
        loops = "".join(f"<p>{' '.join(map(str, quad))}</p>" for quad in QUADS)
        return f'<polygons count="{len(QUADS)}" material="sym">{inputs}{loops}</polygons>'
    strips = "".join(
        f"<p>{' '.join(str(SIDE * (row + (i + 1) % 2) + i // 2) for i in range(2 * SIDE))}</p>" for row in range(SIDE - 1)
    )
    return f'<tristrips count="{SIDE - 1}" material="sym">{inputs}{strips}</tristrips>'


def dae_kinds():
    """{property: Kind}"""
    png, plain, look = {"a.png": picture()}, dae(), glb(coloured())
    mapped = {"look": MAP, "images": IMAGE.format("a.png"), "params": SAMPLED.format("")}
    red, whole = _colour("0.9 0.1 0.1 1"), glb(base(), {"NORMAL": NORMALS, "COLOR_0": _linear(COLOURS)})

    green = [*_linear(np.array([0.1, 0.7, 0.2])).tolist(), 1]

    def row(data, without=plain, like="three.js", expected=b"", **files):
        return Kind({"model.dae": data, **files}, {"model.dae": without, **files}, like, expected)

    def faded(opaque, colour, amount):
        return dae(
            f'{red}<transparent opaque="{opaque}"><color>{colour}</color></transparent>'
            f"<transparency><float>{amount}</float></transparency>"
        )

    def wrapped(mode, number):
        """A picture 2.5 times across by a wrap mode of COLLADA, and of glTF."""
        sampler = SAMPLED.format(f"<wrap_s>{mode}</wrap_s><wrap_t>{mode}</wrap_t>")
        texture = Texture(picture(), sampler={"wrapS": number, "wrapT": number})
        like = glb(coloured(texture), {"NORMAL": NORMALS, "TEXCOORD_0": (UVS * 2.5).astype(np.float32)})
        return row(dae(**mapped | {"params": sampler}, uvs=UVS * 2.5), dae(**mapped, uvs=UVS * 2.5), "construction", like, **png)

    twisted = "<rotate>0 0 1 50</rotate><scale>0.6 1.4 1</scale>"
    library = f'<library_nodes><node id="k"><rotate>0 0 1 40</rotate>{INSTANCE}</node></library_nodes>'
    kinds = {
        "diffuse colour": row(dae(red)),
        "diffuse texture": row(dae(**mapped), **png),
        **{f"diffuse of {shading}": row(dae(red, shading)) for shading in ("phong", "blinn")},
        "emission of constant": row(
            dae("<emission><color>0.1 0.7 0.2 1</color></emission>", "constant"),
            like="construction",
            expected=glb({**base(baseColorFactor=green), "extensions": {"KHR_materials_unlit": {}}}),
        ),
        "emission": row(
            dae("<emission><color>0.1 0.7 0.2 1</color></emission>" + _colour("0.2 0.2 0.2 1")), dae(_colour("0.2 0.2 0.2 1"))
        ),
        "emission texture": row(
            dae(**mapped | {"look": MAP.replace("diffuse", "emission") + _colour("0 0 0 1")}),
            dae(_colour("0 0 0 1")),
            "construction",
            glb({**base(baseColorFactor=[0, 0, 0, 1]), "emissiveTexture": Texture(picture()), "emissiveFactor": [1, 1, 1]}),
            **png,
        ),
        "transparent A_ONE": row(faded("A_ONE", "1 1 1 1", 0.3), dae(red)),
        "transparent RGB_ZERO": row(faded("RGB_ZERO", "0.7 0.7 0.7 1", 1), dae(red)),
        "texture named without sampler": row(
            dae(**mapped | {"look": MAP.replace('texture="s"', 'texture="i"'), "params": ""}),
            like="construction",
            expected=look,
            **png,
        ),
        "up_axis Z_UP": row(dae(asset="<up_axis>Z_UP</up_axis>")),
        "up_axis X_UP": row(dae(asset="<up_axis>X_UP</up_axis>"), like="assimp"),
        "unit": row(dae(asset='<unit name="inch" meter="0.0254"/><up_axis>Y_UP</up_axis>')),
        "node rotate and scale": row(dae(node=twisted)),
        "node translate": row(dae(after=f"<node><translate>0.3 1.6 0</translate>{INSTANCE}</node>")),
        "node matrix": row(dae(node="<matrix>0 -1 0 0 1 0 0 0 0 0 1 0 0 0 0 1</matrix>")),
        "node lookat": row(dae(node="<lookat>0 0 3 0 0 0 1 1 0</lookat>"), like="assimp"),
        "instance_node": row(dae(library=library, instance='<instance_node url="#k"/>'), like="assimp"),
        "polylist": row(dae(**mapped, shape="polylist"), **png),
        "polygons": row(dae(**mapped, shape="polygons"), like="assimp", **png),
        "tristrips": row(dae(**mapped, shape="tristrips"), like="construction", expected=look, **png),
        "COLOR": row(dae(colours=COLOURS), like="construction", expected=whole),
        "NORMAL": row(dae(normals=NORMALS + [0.9, 0.5, 0])),
        "TEXCOORD of another set": row(
            dae(**mapped, uv_set=1, bind='<bind_vertex_input semantic="UV" input_semantic="TEXCOORD" input_set="1"/>'),
            like="construction",
            expected=look,
            **png,
        ),
        "TEXCOORD without bind": row(dae(**mapped, bind=""), like="construction", expected=look, **png),
        "wrap_s CLAMP": wrapped("CLAMP", 33071),
        "wrap_s MIRROR": wrapped("MIRROR", 33648),
        "double_sided": row(
            dae(extra='<extra><technique profile="GOOGLEEARTH"><double_sided>1</double_sided></technique></extra>'),
            like="construction",
            expected=glb({**base(), "doubleSided": True}),
        ),
        "bump": row(
            dae(
                **mapped | {"look": _colour("1 1 1 1")},
                extra='<extra><technique profile="FCOLLADA"><bump><texture texture="s" texcoord="UV"/>'
                "</bump></technique></extra>",
            ),
            like="construction",
            expected=glb({**base(), "normalTexture": Texture(bumps())}),
            **{"a.png": bumps()},
        ),
    }
    names = {"percent-encoded": "a%20b.png", "file:///": "file:///C:/job/a b.png", "in ./maps": "./maps/a b.png"}
    for text, name in names.items():
        path = "maps/a b.png" if "maps" in name else "a b.png"
        kinds[f"init_from {text}"] = row(
            dae(**mapped | {"images": IMAGE.format(name)}), like="construction", expected=look, **{path: picture()}
        )
    return kinds

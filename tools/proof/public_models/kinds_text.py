"""OBJ with MTL, PLY and COLLADA files in each of which one property is the only thing that shows: {property: Kind}."""

from dataclasses import replace

import numpy as np

from tools.proof.public_models import kinds_gltf as gltf

from tools.proof.public_models.kinds_gltf import (  # isort: skip
    COLOURS, FACES, NORMALS, POSITIONS, SIDE, UVS, Kind, Texture, base, bumps, coloured, glb, picture)

QUADS = [[a, a + 1, a + SIDE + 1, a + SIDE] for row in range(SIDE - 1) for a in range(row * SIDE, row * SIDE + SIDE - 1)]
RED, WHITE = "newmtl m\nKd 0.9 0.1 0.1\n", "newmtl m\nKd 1 1 1\n"
MAPPED = "newmtl m\nKd 1 1 1\nmap_Kd a.png\n"
TWO = "newmtl m\nKd 1 1 1\nnewmtl n\nKd 0.1 0.2 0.9\n"


def _rows(word, values):
    return "".join(f"{word} {' '.join(f'{value:.6g}' for value in row)}\n" for row in values)


def obj(faces="{0}/{0}/{0}", head="mtllib a.mtl\n", use="usemtl m\n", colours=None, uvs=UVS, normals=NORMALS, between=""):
    """Return the patch as an OBJ file of quads. faces: format of a corner, with {0} for its number from 1; head, use: lines that
    name the material library and material; between: lines in the middle of the faces."""
    positions = POSITIONS if colours is None else np.hstack([POSITIONS, colours])
    lines = ["f " + " ".join(faces.format(i + 1, i - len(POSITIONS)) for i in quad) + "\n" for quad in QUADS]
    half = len(lines) // 2
    flip = np.column_stack([uvs[:, 0], 1 - uvs[:, 1]])
    parts = head, _rows("v", positions), _rows("vt", flip), _rows("vn", normals), use, *lines[:half], between, *lines[half:]
    return "".join(parts).encode()


def _obj(with_it, without=None, mtl=MAPPED, expected=b"", **files):
    files = {"a.mtl": mtl.encode(), "a.png": picture(), **files}
    return Kind({"model.obj": with_it, **files}, {"model.obj": obj() if without is None else without, **files},
                "construction" if expected else "three.js", expected)


def _mtl(with_it, without=WHITE, **files):
    """A Kind of two material files."""
    return Kind(*({"model.obj": obj(), "a.mtl": text.encode(), **files} for text in (with_it, without)))


def _linear(colours):
    return np.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4).astype(np.float32)


def _painted(colours=COLOURS, **more):
    """A GLB whose vertices have sRGB colours, beside the usual attributes."""
    return glb(base(), {"NORMAL": NORMALS, **more, "COLOR_0": _linear(colours)})


def obj_kinds():
    """{property: Kind}"""
    png, look, tilted, other = {"a.png": picture()}, glb(coloured()), NORMALS + [0.9, 0.5, 0], b"newmtl n\nKd 0 0 1\n"
    framed = {"NORMAL": NORMALS, "TEXCOORD_0": UVS, "TANGENT": gltf.TANGENTS}  # three.js makes up others where a file has none
    bumpy, painted = glb({**base(), "normalTexture": Texture(bumps())}, framed), _painted(TEXCOORD_0=UVS)
    ruddy = glb(base(baseColorFactor=[*_linear(np.array([0.9, 0.1, 0.1])).tolist(), 1]))
    glossy = glb(base(metallicFactor=1.0, roughnessFactor=0.2))
    red, bump, drop = "newmtl m\nKd 1 0 0\n", {"b.png": bumps()}, obj(use="")
    plain, mapped = ({"model.obj": obj(), "a.mtl": text.encode()} for text in (WHITE, MAPPED))
    kind_of = lambda line, like, **files: Kind({**plain, "a.mtl": (WHITE + line).encode(), **files}, plain, "construction", like)
    mrgb = "".join("ff" + "".join(f"{round(255 * value):02x}" for value in row) for row in COLOURS)
    mrgb = "".join(f"#MRGB {mrgb[i : i + 512]}\n" for i in range(0, len(mrgb), 512)).encode()
    maps = {
        "name with spaces": ("a b.png", {"a b.png": picture()}), "in a folder": ("maps/a.png", {"maps/a.png": picture()}),
        "as JPEG": ("a.jpg", {"a.jpg": picture("JPEG", quality=95)}), "as TGA": ("a.tga", {"a.tga": picture("TGA")}),
        "as BMP": ("a.bmp", {"a.bmp": picture("BMP")})}
    elsewhere = {"with backslashes": ("maps\\a.png", {"maps/a.png": picture()}), "of other case": ("A.PNG", png),
                 "absolute elsewhere": ("C:\\job\\a.png", png)}
    return {
        "Kd": _mtl(RED), "map_Kd": _mtl(MAPPED, **png), "Kd times map_Kd": _mtl(RED + "map_Kd a.png\n", MAPPED, **png),
        **{f"map_Kd {name}": _mtl(f"{WHITE}map_Kd {words}\n", **at) for name, (words, at) in maps.items()},
        **{f"map_Kd {words[:2]}": _mtl(f"{WHITE}map_Kd {words} a.png\n", MAPPED, **png)
           for words in ("-s 2 3 1", "-o 0.4 0.2 0")},
        **{f"map_Kd {name}": kind_of(f"map_Kd {words}\n", look, **at) for name, (words, at) in elsewhere.items()},
        "map_Ka alone": kind_of("map_Ka a.png\n", look, **png),
        "d": _mtl(red + "d 0.3\n", red), "Tr": _mtl(red + "Tr 0.7\n", red),
        "map_d": _mtl(MAPPED + "map_d d.png\n", MAPPED, **png, **{"d.png": picture(mode="L")}),
        "Ke": _mtl(RED + "Ke 0.2 0.6 0.9\n", RED), "map_Ke": _mtl(RED + "Ke 1 1 1\nmap_Ke a.png\n", RED, **png),
        "norm": kind_of("norm b.png\n", bumpy, **bump),
        "map_Bump of a normal map": kind_of("map_Bump -bm 1 b.png\n", bumpy, **bump),
        "map_Bump of heights": _mtl(WHITE + "map_Bump -bm 4 h.png\n", **{"h.png": bumps("PNG", "heights")}),
        "Pm and Pr": replace(kind_of("Pm 1\nPr 0.2\n", glossy), without={"model.glb": glb(base())}),
        "mtllib with spaces": _obj(obj(head="mtllib a b.mtl\n"), obj(head=""), **{"a b.mtl": MAPPED.encode()}),
        "mtllib twice": _obj(obj(head="mtllib n.mtl\nmtllib a.mtl\n"), obj(head=""), **{"n.mtl": other}),
        "mtllib of two names": _obj(obj(head="mtllib n.mtl a.mtl\n"), obj(head=""), expected=look, **{"n.mtl": other}),
        "usemtl in between": _obj(obj(between="usemtl n\n"), obj(), TWO),
        "o and g in between": _obj(obj(between="o x\ng y\nusemtl n\n"), obj(), TWO),
        "newmtl with spaces": _obj(obj(use="usemtl m 1\n"), drop, "newmtl m 1\nKd 0.9 0.1 0.1\n"),
        "v with colours": _obj(obj(colours=COLOURS, use=""), drop),
        "v with colours of 0 to 255": _obj(obj(colours=np.round(COLOURS * 255), use=""), drop, expected=painted),
        "#MRGB of ZBrush": _obj(drop + mrgb, drop, expected=painted), "vn": _obj(obj(normals=tilted), mtl=WHITE),
        "negative indices": _obj(obj("{1}/{1}/{1}"), drop),
        "f with vn alone": _obj(obj("{0}//{0}", normals=tilted), obj("{0}//{0}"), WHITE),
        "polygon of five corners": _obj(obj(between="f 1/1/1 13/13/13 169/169/169 163/163/163 157/157/157\n")),
        "lines joined by a backslash": _obj(obj().replace(b"f 1/1/1 2/2/2", b"f 1/1/1 \\\n2/2/2"), drop),
        "ends of lines of Windows": Kind({name: data.replace(b"\n", b"\r\n") for name, data in mapped.items()} | png, plain),
        "byte order mark": _obj(b"\xef\xbb\xbf" + obj(), drop, expected=look),
        "tabs in MTL": Kind({**plain, "a.mtl": b"newmtl m\n\tKd\t0.9 0.1 0.1\n"}, plain, "construction", ruddy)}


# PLY


def ply(columns, form="ascii", faces=None, face="property list uchar int vertex_indices", comment=""):
    """Return the patch as a PLY file. columns: [(names of properties, type, array (n, .))] of vertices; faces: rows, each of
    lists or scalars in the order of the properties in `face`."""
    faces = [[quad] for quad in QUADS] if faces is None else faces
    kinds = {"float": "f4", "double": "f8", "uchar": "u1", "ushort": "u2", "int": "i4", "char": "i1", "short": "i2"}
    names = "".join(f"property {of} {name}\n" for words, of, _ in columns for name in words.split())
    element = "tristrips" if "tristrips" in face else "face"
    face = face.removeprefix("tristrips: ")
    head = (f"ply\nformat {form} 1.0\n{comment}element vertex {len(POSITIONS)}\n{names}element {element} {len(faces)}\n{face}\n"
            "end_header\n").encode()
    if form == "ascii":
        rows = np.hstack([values.astype(float) for _, _, values in columns])
        lines = [" ".join(f"{value:.7g}" for value in row) for row in rows]
        lines += [" ".join(str(word) for part in row for word in ((len(part), *part) if isinstance(part, list) else (part,
                      ))) for row in faces]
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


XYZ, NXYZ = ("x y z", "float", POSITIONS), ("nx ny nz", "float", NORMALS)
ST = ("s t", "float", np.column_stack([UVS[:, 0], 1 - UVS[:, 1]]))
BYTES = np.round(COLOURS * 255)
RGB = ("red green blue", "uchar", BYTES)


def ply_kinds():
    """{property: Kind}"""
    tilted = (NORMALS + [0.9, 0.5, 0]) / np.linalg.norm(NORMALS + [0.9, 0.5, 0], axis=1, keepdims=True)
    alpha, shown, look = np.round(60 + 190 * UVS[:, :1]), _painted(BYTES / 255), glb(coloured())
    clear = glb({**base(), "alphaMode": "BLEND"},
                {"NORMAL": NORMALS, "COLOR_0": np.hstack([_linear(BYTES / 255), alpha / 255]).astype(np.float32)})
    strip = [index for row in range(SIDE - 1)
             for index in ([SIDE * (row + (i + 1) % 2) + i // 2 for i in range(2 * SIDE)] + [-1])]
    wedges = [[quad, [float(x) for corner in quad for x in (UVS[corner, 0], 1 - UVS[corner, 1])]] for quad in QUADS]
    tinted = [[quad, *(int(value) for value in BYTES[quad[0]])] for quad in QUADS]
    plain, little, indices = ply([XYZ, NXYZ]), "binary_little_endian", "property list uchar int vertex_indices"
    by_face = indices + "".join(f"\nproperty uchar {name}" for name in ("red", "green", "blue"))
    textured, png = {"comment": "comment TextureFile a.png\n"}, {"a.png": picture()}
    coloured_by = lambda names, of="uchar", values=BYTES: [XYZ, NXYZ, (names, of, values)]
    every, between = [XYZ, NXYZ, RGB], [XYZ, ("quality", "float", UVS[:, :1]), NXYZ, ("flags", "int", UVS[:, :1]), RGB]

    def row(data, expected=b"", without=plain, **files):
        like = "construction" if expected else "three.js"
        return Kind({"model.ply": data, **files}, {"model.ply": without, **files}, like, expected)

    return {
        "red green blue": row(ply(every)), "diffuse_red": row(ply(coloured_by("diffuse_red diffuse_green diffuse_blue"))),
        "r g b": row(ply(coloured_by("r g b"))),
        "colours as floats": row(ply(coloured_by("red green blue", "float", COLOURS)), shown),
        "colours as ushorts": row(ply(coloured_by("red green blue", "ushort", COLOURS * 65535)), shown),
        "alpha": row(ply([*every, ("alpha", "uchar", alpha)]), clear, ply(every)), "little endian": row(ply(every, little)),
        "big endian": row(ply(every, "binary_big_endian")),
        "doubles": row(ply([("x y z", "double", POSITIONS), NXYZ, RGB], little)),
        "other properties between": row(ply(between, little)),
        "vertex_index": row(ply(every, face="property list uchar int vertex_index")),
        "indices as uints of an int count": row(ply(every, little, face="property list int int vertex_indices")),
        "nx ny nz": row(ply([XYZ, ("nx ny nz", "float", tilted)])),
        "tristrips": row(ply(every, little, [[strip]], "tristrips: property list int int vertex_indices"), shown),
        "colours of faces": row(ply([XYZ, NXYZ], faces=tinted, face=by_face), _by_face(tinted), plain),
        **{f"TextureFile{name}": row(ply([XYZ, NXYZ, (words, *ST[1:])], **textured), look, **png)
           for name, words in ((", s t", "s t"), (" and texture_u", "texture_u texture_v"), (" and u v", "u v"))},
        "texcoord of faces": row(ply([XYZ, NXYZ], faces=wedges, face=f"{indices}\nproperty list uchar float texcoord",
                                     **textured), look, **png),
        "quads": row(plain, glb(base(), {"NORMAL": NORMALS}), ply([XYZ, NXYZ], faces=[[quad[:3]] for quad in QUADS]))}


def _by_face(tinted):
    """A GLB whose faces have colours of their own."""
    corners = np.array([[quad[i] for i in (0, 1, 2, 0, 2, 3)] for quad, *_ in tinted]).ravel()
    colours = np.repeat(_linear(np.array([rgb for _, *rgb in tinted]) / 255), 6, axis=0).astype(np.float32)
    return glb(base(), {"NORMAL": NORMALS[corners], "COLOR_0": colours}, faces=None, positions=POSITIONS[corners])


# COLLADA

IMAGE = '<library_images><image id="i"><init_from>{}</init_from></image></library_images>'
SAMPLED = ('<newparam sid="f"><surface type="2D"><init_from>i</init_from></surface></newparam>'
           '<newparam sid="s"><sampler2D><source>f</source>{}</sampler2D></newparam>')
MAP = '<diffuse><texture texture="s" texcoord="UV"/></diffuse>'


def _colour(text):
    return f"<diffuse><color>{text}</color></diffuse>"


WHITE_LOOK = _colour("1 1 1 1")


def _source(name, values, words):
    params = "".join(f'<param name="{word}" type="float"/>' for word in words)
    return (f'<source id="{name}"><float_array id="{name}-a" count="{values.size}">{" ".join(f"{v:.6g}" for v in values.ravel())}'
            f'</float_array><technique_common><accessor source="#{name}-a" count="{len(values)}" stride="{len(words)}">{params}'
            "</accessor></technique_common></source>")


def dae(look=WHITE_LOOK, shading="lambert", asset="<up_axis>Y_UP</up_axis>", images="", params="", node="", after="", **more):
    """Return the patch as a COLLADA file. look, shading: of the material; other arguments: pieces of XML in place. more: extra
    (of the profile), colours, normals, uv_set, bind, shape (of the triangles)."""
    uvs, normals = more.get("uvs", UVS), more.get("normals", NORMALS)
    flip = np.column_stack([uvs[:, 0], 1 - uvs[:, 1]])
    sources = _source("p", POSITIONS, "XYZ") + _source("n", normals, "XYZ") + _source("t", flip, "ST")
    inputs = ('<input semantic="VERTEX" source="#v" offset="0"/><input semantic="NORMAL" source="#n" offset="0"/>'
              f'<input semantic="TEXCOORD" source="#t" offset="0" set="{more.get("uv_set", 0)}"/>')
    if "colours" in more:
        sources += _source("c", more["colours"], "RGBA"[: more["colours"].shape[1]])
        inputs += '<input semantic="COLOR" source="#c" offset="0" set="0"/>'
    shape = more.get("shape", "triangles")
    bind = more.get("bind", '<bind_vertex_input semantic="UV" input_semantic="TEXCOORD" input_set="0"/>')
    geometry = (f'<geometry id="g"><mesh>{sources}<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>'
                f"{_primitives(shape, inputs)}</mesh></geometry>")
    instance = (f'<instance_geometry url="#g"><bind_material><technique_common><instance_material symbol="sym" target="#m">{bind}'
                "</instance_material></technique_common></bind_material></instance_geometry>")
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


INSTANCE = ('<instance_geometry url="#g"><bind_material><technique_common><instance_material symbol="sym" target="#m"/>'
            "</technique_common></bind_material></instance_geometry>")


def _primitives(shape, inputs):
    """The patch as an element of a mesh: triangles, polylist, polygons or tristrips."""
    text = lambda rows: " ".join(str(i) for row in rows for i in row)
    strips = [[SIDE * (row + (i + 1) % 2) + i // 2 for i in range(2 * SIDE)] for row in range(SIDE - 1)]
    count, body = {
        "triangles": (len(FACES), f"<p>{text(FACES)}</p>"),
        "polylist": (len(QUADS), f"<vcount>{'4 ' * len(QUADS)}</vcount><p>{text(QUADS)}</p>"),
        "polygons": (len(QUADS), "".join(f"<p>{text([quad])}</p>" for quad in QUADS)),
        "tristrips": (len(strips), "".join(f"<p>{text([strip])}</p>" for strip in strips))}[shape]
    return f'<{shape} count="{count}" material="sym">{inputs}{body}</{shape}>'


def dae_kinds():
    """{property: Kind}"""
    png, plain, look = {"a.png": picture()}, dae(), glb(coloured())
    mapped = {"look": MAP, "images": IMAGE.format("a.png"), "params": SAMPLED.format("")}
    red, black, grey, white = _colour("0.9 0.1 0.1 1"), _colour("0 0 0 1"), _colour("0.2 0.2 0.2 1"), _colour("1 1 1 1")
    emission, green = "<emission><color>0.1 0.7 0.2 1</color></emission>", [*_linear(np.array([0.1, 0.7, 0.2])).tolist(), 1]
    extra = lambda profile, text: f'<extra><technique profile="{profile}">{text}</technique></extra>'
    bind = '<bind_vertex_input semantic="UV" input_semantic="TEXCOORD" input_set="1"/>'
    library = f'<library_nodes><node id="k"><rotate>0 0 1 40</rotate>{INSTANCE}</node></library_nodes>'
    unlit = {**base(baseColorFactor=green), "extensions": {"KHR_materials_unlit": {}}}
    glowing = {**base(baseColorFactor=[0, 0, 0, 1]), "emissiveTexture": Texture(picture()), "emissiveFactor": [1, 1, 1]}

    def row(data, without=plain, like="", expected=b"", **files):
        like = like or ("construction" if expected else "three.js")
        return Kind({"model.dae": data, **files}, {"model.dae": without, **files}, like, expected)

    def faded(opaque, colour, amount):
        return row(dae(f'{red}<transparent opaque="{opaque}"><color>{colour}</color></transparent>'
                       f"<transparency><float>{amount}</float></transparency>"), dae(red))

    def wrapped(mode, number):
        """A picture 2.5 times across by a wrap mode of COLLADA, and of glTF."""
        sampler = {"params": SAMPLED.format(f"<wrap_s>{mode}</wrap_s><wrap_t>{mode}</wrap_t>")}
        texture = Texture(picture(), sampler={"wrapS": number, "wrapT": number})
        like = glb(coloured(texture), {"NORMAL": NORMALS, "TEXCOORD_0": (UVS * 2.5).astype(np.float32)})
        return row(dae(**mapped | sampler, uvs=UVS * 2.5), dae(**mapped, uvs=UVS * 2.5), expected=like, **png)

    kinds = {
        "diffuse colour": row(dae(red)), "diffuse texture": row(dae(**mapped), **png),
        **{f"diffuse of {shading}": row(dae(red, shading)) for shading in ("phong", "blinn")},
        "emission of constant": row(dae(emission, "constant"), expected=glb(unlit)),
        "emission": row(dae(emission + grey), dae(grey)),
        "emission texture": row(dae(**mapped | {"look": MAP.replace("diffuse", "emission") + black}), dae(black),
                                expected=glb(glowing), **png),
        "transparent A_ONE": faded("A_ONE", "1 1 1 1", 0.3), "transparent RGB_ZERO": faded("RGB_ZERO", "0.7 0.7 0.7 1", 1),
        "texture named without sampler": row(dae(**mapped | {"look": MAP.replace('texture="s"', 'texture="i"'), "params": ""}),
                                             expected=look, **png),
        "up_axis Z_UP": row(dae(asset="<up_axis>Z_UP</up_axis>")),
        "up_axis X_UP": row(dae(asset="<up_axis>X_UP</up_axis>"), like="assimp"),
        "unit": row(dae(asset='<unit name="inch" meter="0.0254"/><up_axis>Y_UP</up_axis>')),
        "node rotate and scale": row(dae(node="<rotate>0 0 1 50</rotate><scale>0.6 1.4 1</scale>")),
        "node translate": row(dae(after=f"<node><translate>0.3 1.6 0</translate>{INSTANCE}</node>")),
        "node matrix": row(dae(node="<matrix>0 -1 0 0 1 0 0 0 0 0 1 0 0 0 0 1</matrix>")),
        "node lookat": row(dae(node="<lookat>0 0 3 0 0 0 1 1 0</lookat>"), like="assimp"),
        "instance_node": row(dae(library=library, instance='<instance_node url="#k"/>'), like="assimp"),
        "polylist": row(dae(**mapped, shape="polylist"), **png),
        "polygons": row(dae(**mapped, shape="polygons"), like="assimp", **png),
        "tristrips": row(dae(**mapped, shape="tristrips"), expected=look, **png),
        "COLOR": row(dae(colours=COLOURS), expected=_painted()), "NORMAL": row(dae(normals=NORMALS + [0.9, 0.5, 0])),
        "TEXCOORD of another set": row(dae(**mapped, uv_set=1, bind=bind), expected=look, **png),
        "TEXCOORD without bind": row(dae(**mapped, bind=""), expected=look, **png),
        "wrap_s CLAMP": wrapped("CLAMP", 33071), "wrap_s MIRROR": wrapped("MIRROR", 33648),
        "double_sided": row(dae(extra=extra("GOOGLEEARTH", "<double_sided>1</double_sided>")),
                            expected=glb({**base(), "doubleSided": True})),
        "bump": row(dae(**mapped | {"look": white}, extra=extra("FCOLLADA", '<bump><texture texture="s" texcoord="UV"/></bump>')),
                    expected=glb({**base(), "normalTexture": Texture(bumps())}), **{"a.png": bumps()})}
    names = {"percent-encoded": "a%20b.png", "file:///": "file:///C:/job/a b.png", "in ./maps": "./maps/a b.png"}
    return kinds | {f"init_from {text}": row(dae(**mapped | {"images": IMAGE.format(name)}), expected=look,
                                             **{"maps/a b.png" if "maps" in name else "a b.png": picture()})
                    for text, name in names.items()}

"""Files of other formats than glTF, written by hand: COLLADA, STL, and textures in KTX2."""

import base64
import struct
import zlib

import numpy as np
from mesh_files import SQUARE, TWO

UV = "0 0 1 0 1 1 0 1"
UPRIGHT = '<asset><unit name="metre" meter="1"/><up_axis>Y_UP</up_axis></asset>'
TRIANGLES = '<triangles count="2" material="skin">{inputs}<p>{indices}</p></triangles>'


def numbers(key, text, names):
    """A <source> of floats."""
    values = text.split()
    params = "".join(f'<param name="{name}" type="float"/>' for name in names)
    return (f'<source id="{key}"><float_array id="{key}-a" count="{len(values)}">{text}</float_array><technique_common><accessor '
            f'source="#{key}-a" count="{len(values) // len(names)}" stride="{len(names)}">{params}</accessor>'
            "</technique_common></source>")


def dae(surface=None, points=SQUARE, diffuse='<texture texture="s" texcoord="UV0"/>', sampler="", effect="", node="", more="",
        bound="", sources="", asset=UPRIGHT):
    """A COLLADA document of one geometry; the keyword arguments are pieces of it."""
    inputs = ('<input semantic="VERTEX" source="#v" offset="0"/><input semantic="TEXCOORD" source="#u0" offset="0" set="0"/>'
              '<input semantic="TEXCOORD" source="#u1" offset="0" set="3"/>')
    surface = surface or TRIANGLES.format(inputs=inputs, indices="0 1 2 0 2 3")
    flat = " ".join(str(x) for x in np.ravel(points))
    return f"""<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
{asset}
<library_images><image id="i"><init_from>t%20ex.png</init_from></image></library_images>
<library_effects><effect id="e"><profile_COMMON>
<newparam sid="f"><surface type="2D"><init_from>i</init_from></surface></newparam>
<newparam sid="s"><sampler2D><source>f</source>{sampler}</sampler2D></newparam>
<technique sid="t"><lambert><diffuse>{diffuse}</diffuse>{effect}</lambert></technique></profile_COMMON></effect></library_effects>
<library_materials><material id="m" name="paint"><instance_effect url="#e"/></material></library_materials>
<library_geometries><geometry id="g"><mesh>{numbers("p", flat, "XYZ")}{numbers("u0", UV, "ST")}
{numbers("u1", UV.replace("1", "0.5"), "ST")}{sources}
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>{surface}</mesh></geometry></library_geometries>{more}
<library_visual_scenes><visual_scene id="w"><node id="n">{node}<instance_geometry url="#g"><bind_material><technique_common>
<instance_material symbol="skin" target="#m">{bound}</instance_material></technique_common></bind_material></instance_geometry>
</node></visual_scene></library_visual_scenes><scene><instance_visual_scene url="#w"/></scene></COLLADA>"""
FACETS = SQUARE[TWO]
XYZ = "property float x\nproperty float y\nproperty float z\n"
FACES = "element face 1\nproperty list uchar int vertex_indices\n"


def ascii_ply(elements, rows, vertices=SQUARE, more="", head=""):
    """An ascii PLY: vertices with `more` properties in their rows, then other elements."""
    points = vertices if isinstance(vertices, list) else [" ".join(map(str, row)) for row in np.asarray(vertices).tolist()]
    return (f"ply\nformat ascii 1.0\n{head}element vertex {len(points)}\n{XYZ}{more}{elements}end_header\n" + "\n".join(points)
            + f"\n{rows}\n")


def stl(facets=FACETS, attributes=(0, 0), header=b"made here", normal=(0, 0, 1), count=None):
    """A binary STL."""
    rows = b"".join(struct.pack("<12fH", *normal, *np.ravel(facet), attribute)
                    for facet, attribute in zip(facets, attributes, strict=True))
    return header.ljust(80, b"\0") + struct.pack("<I", len(facets) if count is None else count) + rows


def stl_text(facets=FACETS, name="a part", normal="0 0 1"):
    loops = "".join(f" facet normal {normal}\n  outer loop\n" + "".join(f"   vertex {x} {y} {z}\n" for x, y, z in facet)
                    + "  endloop\n endfacet\n" for facet in facets)
    return f"solid {name}\n{loops}endsolid {name}\n"


KTX2_FILES = {
    "ETC1S": (
        "c-mX-9TK5nWU!l;ONxsD2pEBw1BzjQ5ea7iu?`SV0b&&(-T_t938ftwAv6;MD$rqoiEA({W@KVuW=6Kd9?tp?1oA){=&bUh%#ze12B*a0%wmPm"
        "yv(xHqT<9H1tUE}0|o{bph?<5b(}z~i)I(H-3kX>AdE*WECzyLR)dNFgBnCofT@8K!eTKnTeE7_s-V!&P*#S6P(7dGdl_axJmheQ!$8pita4&7"
        "7hJysg8&-<EFvV("),
    "ETC1S with alpha": (
        "c-mX-9TK5nWU!l;ONxsD2pEBw1BzjQ5ea7iu?-L}0b&&(J^@uT0ZK<OLTDBSRA2+8nHVe>7Bez2Ff#+~fLme@SN9(X92o5Rk@@mK8tBaOqRf)i"
        "A_k|#;>==&(7epD)S}|V90emiLjwi|Rt9DU9iTd1Al65-n+XXk9B_dMK5}6(5CpRtbOadGAc6u+4V+N-7bG)>gocK)0@*88ty;yza1g5T(|vUh"
        "Mgv9#uvQNx1*Zm(u^mNS!8~wdfIi@T!T<myq%95"),
    "UASTC": (
        "c-mX-9TK5nWU!l;ONxsD2pEBw1BzjQ5sI0BI0J}vfOrZJt1w`K9Z=c?N;^Pl9VpGjpuw<=k%@tsnSnt7uB#r-`VR#1KpN<*@}kU=)FK9_#Ny0i"
        "h0wgrvecsD#2f`9JwpQq292%ye-#{J85w?jmuGk&U&SE)K>mR|6F-AE!-N0wOb-|tzJpAvdC$UN+|Brt;ShHM3jl<EDQ*"),
    "UASTC with alpha in Zstandard": (
        "c-mX-9TK5nWU!l;ONxsD2pEBw1BzjQ5sI0BI0J}vfOrZJt1w`K9Z=c?N;^Pl9VpGjpuw<=k%@tsnSnt7uB)CI#`+Hg@<1Bstn#AFlGGvwr^MpS"
        "VujGW%(B#?;=~*UBRxX{1_q6-`hOK1Vi_5Je3xf<AYa8G{y_eLJQF{IIKzYg@=OmH8NP!Is(H`CVBF34li?6|0t*0k+bD7"),
    "UASTC with four levels": (
        "c-mX-9TK5nWU!l;ONxsD2pEBw1Bzh)B*p?|ZvbK)Aie{{Dh!ywfDuAFFrd;3P;mhUG#ZCE0}gQ=D9yy6!LW>xiGi6JNe@Fkob?|F<bgEMd*wx$"
        "C8<RWPKm{t#R{Q$nPsU(#fdozMtX(@3=Gq!Pya3->ct4t7p$f2u_WfC=ZqOC4gdewGhEK#R+u?KZIXzJBf|<H|GPZH1Nkb1f5jijKagkQNAMXQ"
        "{Fi5X05|VD$Q?EB;d}ry#WY|"),
}


def ktx2(kind):
    return zlib.decompress(base64.b85decode(KTX2_FILES[kind]))

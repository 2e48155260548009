"""3MF files written by hand: the square as an object, the model around it, and the archive around that."""

import io
import zipfile

from mesh_files import SQUARE

CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
MATERIAL = "http://schemas.microsoft.com/3dmanufacturing/material/2015/02"
PRODUCTION = "http://schemas.microsoft.com/3dmanufacturing/production/2015/06"
VERTICES = "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in SQUARE)


def mesh(first="", second="", key="1", attributes=""):
    """The square as an object; first and second are the attributes of its triangles."""
    return (f'<object id="{key}" type="model" {attributes}><mesh><vertices>{VERTICES}</vertices><triangles>'
            f'<triangle v1="0" v2="1" v3="2" {first}/><triangle v1="0" v2="2" v3="3" {second}/></triangles></mesh></object>')


def model(resources, build='<item objectid="1"/>', head="", unit="inch"):
    return (f'<?xml version="1.0" encoding="UTF-8"?><model unit="{unit}" xmlns="{CORE}" '
            f'xmlns:m="{MATERIAL}" xmlns:p="{PRODUCTION}">'
            f"{head}<resources>{resources}</resources><build>{build}</build></model>")


def package(text, start="3D/3dmodel.model", **parts):
    """A 3MF archive; parts: name with _slash_ for / -> bytes."""
    out = io.BytesIO()
    relation = ('<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships"><Relationship Id="r" '
                f'Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel" Target="/{start}"/></Relationships>')
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("[Content_Types].xml", "<Types/>")
        archive.writestr("_rels/.rels", relation)
        archive.writestr(start, text)
        for name, data in parts.items():
            archive.writestr(name.replace("_slash_", "/").replace("_dot_", "."), data)
    return out.getvalue()

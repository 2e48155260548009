"""Nodes for ComfyUI: "MESH to texf" and "Save texf page". docs/guide/in_comfyui.md."""

import io
import logging
import os
import sys

ATTRIBUTES = {"vertices": "POSITION", "normals": "NORMAL", "tangents": "TANGENT", "uvs": "TEXCOORD_0", "vertex_colors": "COLOR_0"}
MAPS = {"texture": "baseColor", "metallic_roughness": "metallicRoughness", "normal_map": "normal", "emissive": "emissive"}


def package():
    """Return the module texfcodec. Raises RuntimeError with the command that installs it, if it is missing or too old."""
    try:
        import texfcodec

        if hasattr(texfcodec, "encode_gltf"):
            return texfcodec
        reason = f"version {getattr(texfcodec, '__version__', 'unknown')} is too old"
    except ImportError as error:
        reason = str(error)
    raise RuntimeError(f'The texf nodes need the Python package texfcodec ({reason}): run "{sys.executable}" -m pip install '
                       "--upgrade texfcodec, and start ComfyUI again.")


def glb_of(mesh, item):
    """Return one mesh of a batch as the bytes of a GLB, with all that the core's own "Save 3D Model" writes of it."""
    package()
    from texfcodec.io.gltf.writer import Document, glb

    array = lambda name: None if getattr(mesh, name, None) is None else getattr(mesh, name)[item].detach().cpu().float().numpy()
    vertices, faces, counts = array("vertices"), mesh.faces[item].detach().cpu().numpy(), getattr(mesh, "vertex_counts", None)
    if counts is not None:  # the rows behind are padding
        vertices, faces = vertices[: int(counts[item])], faces[: int(mesh.face_counts[item])]
    rows = {gltf: array(name)[: len(vertices)] for name, gltf in ATTRIBUTES.items() if array(name) is not None}
    maps = {name: array(name) for name in MAPS if "TEXCOORD_0" in rows and array(name) is not None}
    document = Document({})
    document.add("materials", material_of(mesh, document, maps, "COLOR_0" in rows))
    if getattr(mesh, "unlit", False) and "texture" not in maps:
        document.json["materials"][0]["extensions"] = {"KHR_materials_unlit": {}}
        document.use_extension("KHR_materials_unlit")
    attributes = {name: document.add_accessor(values, f"VEC{values.shape[1]}", None) for name, values in rows.items()}
    indices = document.add_accessor(faces.reshape(-1).astype("uint32"), "SCALAR", None)
    document.add("meshes", {"primitives": [{"attributes": attributes, "indices": indices, "material": 0}]})
    document.json["scenes"][0]["nodes"] = [document.add("nodes", {"mesh": 0})]
    return b"".join(glb(document))


def texture_of(document, pixels):
    """Add an image, float [H, W, 3] in 0..1, to a document; return a glTF textureInfo."""
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray((pixels.clip(0, 1) * 255).round().astype("uint8")).save(file, format="PNG", compress_level=1)
    image = document.add("images", {"bufferView": document.add_view(file.getvalue()), "mimeType": "image/png"})
    return {"index": document.add("textures", {"source": image})}


def material_of(mesh, document, maps, coloured):
    """Return the glTF material of a MESH. maps: pixels, float [H, W, 3] by name; coloured: there are colours at vertices."""
    settings = getattr(mesh, "material", None) or {}
    seen, glow = "texture" in maps or coloured, settings.get("emissive_factor", [0, 0, 0])
    factor = lambda name, unset: unset if settings.get(name, -1) < 0 else settings[name]
    pbr = {"baseColorFactor": settings.get("base_color_factor") or ([1, 1, 1, 1] if seen else [0.22, 0.22, 0.22, 1]),
           "metallicFactor": factor("metallic_factor", int("metallic_roughness" in maps)),
           "roughnessFactor": factor("roughness_factor", 1 if seen or "metallic_roughness" in maps else 0.5)}
    material = {"pbrMetallicRoughness": pbr, "doubleSided": bool(settings.get("double_sided", True)),
                "emissiveFactor": [1, 1, 1] if "emissive" in maps and not any(glow) else [min(1, x) for x in glow]}
    for name, pixels in maps.items():
        (pbr if name in ("texture", "metallic_roughness") else material)[MAPS[name] + "Texture"] = texture_of(document, pixels)
    if "normal_map" in maps:
        material["normalTexture"]["scale"] = settings.get("normal_scale", 1)
    if getattr(mesh, "occlusion_in_mr", False) and "metallic_roughness" in maps:
        material["occlusionTexture"] = pbr["metallicRoughnessTexture"] | {"strength": settings.get("occlusion_strength", 1)}
    if settings.get("emissive_strength", 1) != 1:
        material["extensions"] = {"KHR_materials_emissive_strength": {"emissiveStrength": settings["emissive_strength"]}}
        document.use_extension("KHR_materials_emissive_strength")
    return material


class MeshToTexf:
    CATEGORY, FUNCTION, RETURN_TYPES = "3d/texf", "encode", ("TEXF",)
    DESCRIPTION = "Encodes each mesh of the batch. r01 is the smallest rate, r06 the closest."
    INPUT_TYPES = classmethod(lambda cls: {"required": {
        "mesh": ("MESH",), "rate": ([f"r0{n}" for n in range(1, 7)], {"default": "r04"}), "effort": (["balanced", "fast"],)}})

    def encode(self, mesh, rate, effort):
        sources = [glb_of(mesh, item) for item in range(len(mesh.vertices))]
        return ([(package().encode(glb, {"rate": rate, "effort": effort}), len(glb)) for glb in sources],)


class SaveTexfPage:
    CATEGORY, FUNCTION, RETURN_TYPES, OUTPUT_NODE = "3d/texf", "save", (), True
    DESCRIPTION = "Writes each stream as a .texf, and as a page that shows it without a server."
    INPUT_TYPES = classmethod(lambda cls: {"required": {
        "texf": ("TEXF",), "filename_prefix": ("STRING", {"default": "3d/texf"})}})

    def save(self, texf, filename_prefix):
        package()
        from folder_paths import get_output_directory, get_save_image_path

        from texfcodec.viewer.page import Shown, export_page

        folder, name, counter, subfolder, _ = get_save_image_path(filename_prefix, get_output_directory())
        files = []
        for number, (data, size) in enumerate(texf, counter):
            stem = f"{name}_{number:05}_"
            for suffix, content in ((".texf", data), (".html", export_page([Shown(stem, size, data)], stem))):
                with open(os.path.join(folder, stem + suffix), "wb") as file:
                    file.write(content)
                files.append({"filename": stem + suffix, "subfolder": subfolder, "type": "output"})
        return {"ui": {"texf": files}}


NODE_CLASS_MAPPINGS = {"MeshToTexf": MeshToTexf, "SaveTexfPage": SaveTexfPage}
NODE_DISPLAY_NAME_MAPPINGS = {"MeshToTexf": "MESH to texf", "SaveTexfPage": "Save texf page"}
try:
    package()
except RuntimeError as error:
    logging.warning(str(error))

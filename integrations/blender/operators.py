"""File > Import > TEXF and File > Export > TEXF."""

import os
import tempfile
from pathlib import Path

import bpy
from bpy.props import BoolProperty, CollectionProperty, EnumProperty, StringProperty
from bpy_extras.io_utils import ExportHelper, ImportHelper

from .codec import Unusable, package, plain_glb, write_coded

APPEARANCES = [("AUTO", "Automatic", "Textures, or colours at vertices where they show as much"),
               ("TEXTURE", "Textures", "Colours over voxels are baked into an atlas"),
               ("VERTEX", "Colours at vertices", "No textures and no UVs")]
FORMS = [("GLB", "Scene (.glb)", "Nodes, skins, animations and all else stay; meshes and images are coded"),
         ("TEXF", "One mesh (.texf)", "The smallest file: one mesh in the pose of the current frame")]
RATES = [(f"r0{n}", f"r0{n}", "") for n in range(1, 7)]
EFFORTS = [("balanced", "Balanced", "Smaller files"), ("fast", "Fast", "Less time")]


class ImportTexf(bpy.types.Operator, ImportHelper):
    """Open meshes coded as .texf"""
    bl_idname, bl_label, bl_options = "import_scene.texf", "Import TEXF", {"REGISTER", "UNDO"}
    filename_ext = ".texf"
    filter_glob: StringProperty(default="*.texf", options={"HIDDEN"})
    files: CollectionProperty(type=bpy.types.OperatorFileListElement, options={"HIDDEN", "SKIP_SAVE"})
    appearance: EnumProperty(name="Colours", items=APPEARANCES, default="AUTO")

    def execute(self, context):
        paths = [os.path.join(os.path.dirname(self.filepath), file.name) for file in self.files] or [self.filepath]
        return {"FINISHED"} if any([self._open(path) for path in paths]) else {"CANCELLED"}

    def _open(self, path):
        try:
            glb, warnings = plain_glb(path, "scene", None if self.appearance == "AUTO" else self.appearance.lower())
            with tempfile.TemporaryDirectory() as folder:
                plain = Path(folder) / (Path(path).stem + ".glb")
                plain.write_bytes(glb)
                result = bpy.ops.import_scene.gltf(filepath=str(plain))
        except (Unusable, OSError, RuntimeError) as error:
            self.report({"ERROR"}, str(error))
            return False
        for mesh in bpy.context.selected_objects:  # a stream has no names
            mesh.name = Path(path).stem
        for sentence in warnings:
            self.report({"WARNING"}, sentence)
        return result == {"FINISHED"}


class ExportTexf(bpy.types.Operator, ExportHelper):
    """Write the scene with coded meshes and images, or one mesh as .texf"""
    bl_idname, bl_label, bl_options = "export_scene.texf", "Export TEXF", {"PRESET"}
    filter_glob: StringProperty(default="*.texf;*.glb", options={"HIDDEN"})
    form: EnumProperty(name="Form", items=FORMS, default="GLB")
    rate: EnumProperty(name="Rate", items=RATES, default="r04", description="r01 is the smallest, r06 the closest")
    effort: EnumProperty(name="Effort", items=EFFORTS, default="balanced")
    use_selection: BoolProperty(name="Selected objects only", default=False)

    @property
    def filename_ext(self):
        return "." + self.form.lower()

    def execute(self, context):
        context.window_manager.progress_begin(0, 100)
        try:
            package()  # before the export, which takes longer
            return self._write(lambda _, done, total: context.window_manager.progress_update(100 * done // max(total, 1)))
        except (Unusable, OSError, RuntimeError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        finally:
            context.window_manager.progress_end()

    def _write(self, on_progress):
        path = self.filepath if self.filepath.endswith((".glb", ".texf")) else self.filepath + self.filename_ext
        with tempfile.TemporaryDirectory() as folder:
            plain = os.path.join(folder, "scene.glb")
            bpy.ops.export_scene.gltf(filepath=plain, export_format="GLB", use_selection=self.use_selection, export_cameras=True,
                                      export_lights=True, export_extras=True)
            size = os.path.getsize(plain)
            coded, warnings = write_coded(plain, path, {"rate": self.rate, "effort": self.effort}, on_progress)
        for sentence in warnings:
            self.report({"WARNING"}, sentence)
        self.report({"INFO"}, f"{os.path.basename(path)}: {coded:,} bytes, {size:,} as an ordinary GLB")
        return {"FINISHED"}


MENUS = {"TOPBAR_MT_file_import": lambda menu, _: menu.layout.operator(ImportTexf.bl_idname, text="TEXF (.texf)"),
         "TOPBAR_MT_file_export": lambda menu, _: menu.layout.operator(ExportTexf.bl_idname, text="TEXF (.texf/.glb)")}


def register() -> None:
    """Add the operators and their menu entries."""
    for operator in (ImportTexf, ExportTexf):
        bpy.utils.register_class(operator)
    for menu, entry in MENUS.items():
        getattr(bpy.types, menu).append(entry)


def unregister() -> None:
    """Remove what register() added."""
    for menu, entry in MENUS.items():
        getattr(bpy.types, menu).remove(entry)
    for operator in (ExportTexf, ImportTexf):
        bpy.utils.unregister_class(operator)

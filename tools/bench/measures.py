"""What a job measures of what it has decoded, and the pictures that it leaves in its folder."""

from dataclasses import replace

import numpy as np

OVERSAMPLING, QUALITY = 2, 92  # pixels averaged a side; of WebP, where blocks of the encoder are not seen any more


def measure_job(scene, decoded, job, folder):
    """Return measures() of a job's decoded asset, with "pictures", the numbers of the views written into its folder, if any."""
    evaluation, threads = job["evaluation"], job["threads"]
    measured = measures(scene, decoded, evaluation, threads)
    if evaluation["pictures"]:
        measured["pictures"] = write_pictures(scene, decoded, evaluation, folder, threads)
    return measured


def measures(scene, decoded, evaluation, threads):
    """Return {"psnr_3d", "image", "maps"} of a decoded Texf or Scene; None for those that evaluation does not request."""
    from texfcodec.metrics.psnr_3d import SourceSamples
    from texfcodec.metrics.views import ViewSettings, compare_views, mesh_psnr_3d
    from texfcodec.render.environment import DAYLIGHT
    from texfcodec.texf import Texf

    measured = {"psnr_3d": None, "image": None, "maps": None}
    if evaluation["samples"] and isinstance(decoded, Texf):
        measured["psnr_3d"] = SourceSamples(scene, evaluation["samples"], threads, evaluation["seed"]).compare(decoded)
    elif evaluation["samples"]:
        measured["psnr_3d"] = mesh_psnr_3d(scene, decoded, evaluation["samples"], threads)
    if evaluation["maps"]:
        from tools.bench.map_errors import map_errors

        measured["maps"] = map_errors(scene, decoded, evaluation["samples"], threads)
    if evaluation["views"]:
        measured["image"] = compare_views(scene, decoded, views=evaluation["views"], size=evaluation["size"],
                                          ssim=evaluation["ssim"], threads=threads,
                                          settings=ViewSettings(environment=DAYLIGHT) if evaluation["lit"] else None)
    return measured


def views_shown(pictures, views):
    """Return the numbers of the views to draw: `pictures` of the metric's `views`, evenly spaced from the top to the bottom."""
    count = min(pictures, views)
    return [(2 * i + 1) * views // (2 * count) for i in range(count)]


def write_pictures(scene, decoded, evaluation, folder, threads):
    """Write source_VIEW and picture_VIEW (WebP, or PNG if Pillow has none) into a job's folder; return the numbers of the views.

    Every job's folder has the source's as well, because it may be all that comes back from where the job ran.
    """
    from PIL import Image, features

    from texfcodec.metrics.views import VIEWS
    from texfcodec.render.camera import bounding_sphere, fibonacci_direction, orthographic
    from texfcodec.render.shade import box_down

    views = evaluation["views"] or VIEWS
    shown, size = views_shown(evaluation["pictures"], views), evaluation["picture_size"] * OVERSAMPLING
    ending, how = (".webp", {"quality": QUALITY, "method": 4}) if features.check("webp") else (".png", {})
    place = bounding_sphere(scene.positions)
    for view in shown:
        camera = orthographic(fibonacci_direction(view, views), *place, size)
        for name, side in (("source", scene), ("picture", decoded)):
            image = box_down(_picture(side, camera, threads).image(), OVERSAMPLING)
            Image.fromarray(np.ascontiguousarray(image)).save(folder / f"{name}_{view:02d}{ending}", **how)
    return shown


def _picture(side, camera, threads):
    """Picture of a Scene or Texf with every back face culled, as compare_views() sees it."""
    from texfcodec.render.shade import render_scene, render_texf
    from texfcodec.texf import Texf

    side = replace(side, materials=[replace(material, double_sided=False) for material in side.materials])
    return (render_texf if isinstance(side, Texf) else render_scene)(side, camera, threads=threads)

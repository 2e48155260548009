"""What texf-enc --advise says."""

from collections.abc import Iterator

MOST_IMAGES = 8  # told one by one
MANY = 20  # times, from which on nobody wants to know how many


def advice_lines(advice: dict) -> Iterator[str]:
    """Lines of encoder.advise.advise's answer."""
    if advice["reason"] or not advice["images"]:
        yield f"all fields would be over voxels: {advice['reason'] or 'no image can stay as texels'}"
    for entry in advice["images"][:MOST_IMAGES]:
        yield _line(entry)
    left = len(advice["images"]) - MOST_IMAGES
    if left > 0:
        texels = sum(entry["predicted"] == "texels" for entry in advice["images"][MOST_IMAGES:])
        yield f"and {left} more images, {texels} of them probably over texels"
    cost = advice["cost"]
    yield (f"about {cost['seconds']:.0f} s on two processors and {cost['bytes']:,} bytes: {cost['faces']:,} faces, "
           f"{cost['texels']:,} values over texels, {cost['voxels']:,} over voxels")
    if advice["refinement"] == "fit":
        yield "voxel colours would be fitted to the surface where that is visible"


def _line(entry):
    width, height = entry["image"]
    what = f"image of {width} x {height}" + (f" with {', '.join(entry['maps'])}" if entry["maps"] else "")
    surely = "probably" if entry["sure"] else "possibly, by a narrow margin,"
    size = ""
    if "times" in entry:
        times, other = entry["times"], "voxels" if entry["predicted"] == "texels" else "texels"
        many = max(times, 1 / times)
        size = f", {other} about {f'{many:.1f}' if many < MANY else f'{MANY} or more'} times the bytes at equal quality"
    why = "; ".join(entry["reasons"])
    return f"{what}: {surely} over {entry['predicted']}{size}" + (f" ({why})" if why else "")

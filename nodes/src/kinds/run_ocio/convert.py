"""Converts colours with OpenColorIO: convert.py REQUEST

REQUEST is a JSON file: `config` (a file or the address of a built-in configuration), `from`, `to`, `display`, `view` (names, or null),
and `files`, each with RGB as 32-bit floats, which are converted into files of the same names in `out`. A null `from` or `to` is linear
Rec.709. Mistakes of the request are written to `out/mistake.json`, what was done to `out/done.json`.
"""

import array
import difflib
import json
import os
import sys

import PyOpenColorIO as ocio

# Only the configuration and the request decide, not the variables of this machine.
for variable in list(os.environ):
    del os.environ[variable]

WORKING = "Linear Rec.709 (sRGB)"
BUILT_IN = "ocio://cg-config-v2.1.0_aces-v1.3_ocio-v2.3"
# Optimisations must not change numbers.
EXACT = ocio.OPTIMIZATION_LOSSLESS
# The second is not a subclass of the first.
ERRORS = (ocio.Exception, ocio.ExceptionMissingFile)


def mistake(field, message, near=()):
    with open("out/mistake.json", "w", encoding="utf-8") as file:
        json.dump({"field": field, "message": message, "near": list(near)}, file)
    sys.exit(0)


def unknown(field, name, names, where="the configuration"):
    names = list(names)
    lower = {other.lower(): other for other in names}
    near = difflib.get_close_matches(name.lower(), lower, n=3, cutoff=0.4)
    what = "colour space" if field in ("from", "to") else field
    mistake(field, f"{where} has no {what} `{name}`", [lower[one] for one in near] or names[:8])


def space(config, field, name):
    if name is None:
        try:
            built_in = ocio.Config.CreateFromBuiltinConfig(BUILT_IN)
            return ocio.Config.IdentifyBuiltinColorSpace(config, built_in, WORKING)
        except ocio.ExceptionMissingFile as error:
            mistake("files", str(error).strip())
        except ocio.Exception as error:
            mistake(field, f"the configuration has no space that is known to be linear Rec.709 ({error})")
    found = config.getColorSpace(name)
    if found is None:
        unknown(field, name, config.getColorSpaceNames())
    return found.getName()


def transform(config, request):
    source = space(config, "from", request["from"])
    display, view = request["display"], request["view"]
    if display is None:
        target = space(config, "to", request["to"])
        return ocio.ColorSpaceTransform(src=source, dst=target), [source, target]
    if display not in config.getDisplays():
        unknown("display", display, config.getDisplays())
    view = view or config.getDefaultView(display)
    if view not in config.getViews(display):
        unknown("view", view, config.getViews(display), f"the display `{display}`")
    shown = ocio.DisplayViewTransform(src=source, display=display, view=view)
    return shown, [source, f"{display}, {view}"]


def main():
    with open(sys.argv[1], encoding="utf-8") as file:
        request = json.load(file)
    place = "builtin" if request["config"].startswith("ocio://") else "config"
    try:
        config = ocio.Config.CreateFromFile(request["config"])
    except ERRORS as error:
        mistake(place, str(error).strip())
    found, names = transform(config, request)
    try:
        processor = config.getProcessor(found)
        exact = processor.getOptimizedCPUProcessor(ocio.BIT_DEPTH_F32, ocio.BIT_DEPTH_F32, EXACT)
    except ERRORS as error:
        # Most often a file that the configuration needs.
        mistake("files" if place == "config" else place, str(error).strip())
    for name in request["files"]:
        pixels = array.array("f")
        with open(name, "rb") as file:
            pixels.frombytes(file.read())
        if pixels:
            exact.applyRGB(pixels)
        with open(os.path.join("out", name), "wb") as file:
            pixels.tofile(file)
    with open("out/done.json", "w", encoding="utf-8") as file:
        json.dump({"version": ocio.__version__, "from": names[0], "to": names[1]}, file)


main()

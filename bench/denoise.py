#!/usr/bin/env python3
"""The filter of the display beside Intel Open Image Denoise: one picture of few samples a pixel, both on the CPU.

    python bench/denoise.py FEW.exr FEW.json REFERENCE.exr TREX TREX_BENCH [ROUNDS [THREADS]]

Needs pyoidn, OpenEXR and numpy. FEW.exr has the layers albedo, normal and depth; FEW.json is the document of the
render that wrote it. Both filters get the same picture on as many threads, and take turns; times are medians of the
rounds, of the filter alone: no reading, no writing, nothing that is done once. Open Image Denoise is set up as its
manual says for a picture in linear light with albedo and normal beside it, and has its default quality. Errors are to
the reference, of pictures as they are shown: each is multiplied by the exposure that the render decided on. Prints a
document for `trex-bench record`; the three pictures stay beside FEW.exr.
"""

import json
import statistics
import subprocess
import sys
import time
from importlib.metadata import version

import numpy as np
import OpenEXR
import pyoidn

RADIANCE = ["R", "G", "B"]
ALBEDO = ["albedo.R", "albedo.G", "albedo.B"]
NORMAL = ["normal.X", "normal.Y", "normal.Z"]


class Oidn:
    """The filter on one picture."""

    def __init__(self, planes, threads):
        self.device = pyoidn.Device(pyoidn.OIDN_DEVICE_TYPE_CPU)
        self.device.set_int("numThreads", threads)
        self.device.commit()
        images = {
            pyoidn.OIDN_IMAGE_COLOR: picture(planes, RADIANCE),
            pyoidn.OIDN_IMAGE_ALBEDO: picture(planes, ALBEDO),
            pyoidn.OIDN_IMAGE_NORMAL: picture(planes, NORMAL),
        }
        self.shown = np.empty_like(images[pyoidn.OIDN_IMAGE_COLOR])
        # The library has no copy of them.
        self.images = {**images, pyoidn.OIDN_IMAGE_OUTPUT: self.shown}
        self.filter = pyoidn.Filter(self.device, pyoidn.OIDN_FILTER_TYPE_RT)
        for name, image in self.images.items():
            self.filter.set_image(name, image, pyoidn.OIDN_FORMAT_FLOAT3)
        self.filter.set_bool("hdr", True)
        self.filter.commit()
        # The first time takes memory.
        self.run()

    def run(self):
        """Smooths the picture: milliseconds."""
        begin = time.perf_counter()
        self.filter.execute()
        took = (time.perf_counter() - begin) * 1e3
        if error := self.device.get_error():
            raise RuntimeError(f"Open Image Denoise: {error}")
        return took


def picture(planes, names):
    return np.ascontiguousarray(np.stack([planes[name] for name in names], axis=-1), dtype=np.float32)


def read(path):
    """The channels of an EXR by name, height x width each, float32."""
    with OpenEXR.File(path, separate_channels=True) as file:
        return {name: channel.pixels.copy() for name, channel in file.channels().items()}


def write(path, pixels):
    """Writes height x width x 3 numbers as an EXR."""
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, {"RGB": np.ascontiguousarray(pixels, dtype=np.float32)}) as file:
        file.write(path)


def document(*command):
    """What a command prints with --json."""
    return json.loads(subprocess.run([*command, "--json"], stdout=subprocess.PIPE, check=True).stdout)


def main(few, render, reference, trex, trex_bench, rounds="5", threads="2"):
    with open(render, encoding="utf-8") as file:
        render = json.load(file)
    exposure, samples = render["exposure"], render["spp"]
    stem = few.removesuffix(".exr")
    planes = read(few)
    oidn = Oidn(planes, int(threads))

    def run_ours():
        common = ["--spp", str(samples), "--rounds", "1", "--threads", threads]
        return document(trex_bench, "smooth", few, "-o", f"{stem}-ours.exr", *common)

    ours, took = [], []
    for turn in range(int(rounds)):
        if turn % 2 == 0:
            ours.append(run_ours())
        took.append(oidn.run())
        if turn % 2 == 1:
            ours.append(run_ours())

    pictures = {"raw": picture(planes, RADIANCE), "ours": picture(read(f"{stem}-ours.exr"), RADIANCE), "oidn": oidn.shown}
    write(f"{stem}-reference.exr", exposure * picture(read(reference), RADIANCE))
    flip, relmse = {}, {}
    for name, pixels in pictures.items():
        write(f"{stem}-{name}.exr", exposure * pixels)
        error = document(trex, "image", "diff", f"{stem}-{name}.exr", f"{stem}-reference.exr", "--flip")
        flip[name], relmse[name] = error["flip"], error["all"]["relmse"]
    median = {key: statistics.median(run[key] for run in ours) for key in ["learn_ms", "refresh_ms", "mix_ms", "filter_ms"]}
    figures = {
        "flip": flip,
        "relmse": relmse,
        "filter_ms": {"ours": median.pop("filter_ms"), "oidn": statistics.median(took)},
        **median,
        **{key: ours[0][key] for key in ["width", "height", "sample_count", "thread_count"]},
        "round_count": int(rounds),
        "exposure": exposure,
        "versions": {package: version(package) for package in ["pyoidn", "numpy"]},
    }
    print(json.dumps({"schema": "trex.denoise/1", "scene": render["scene"], "seed": 1, **figures}))


if __name__ == "__main__":
    main(*sys.argv[1:])

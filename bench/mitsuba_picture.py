"""A picture of a scene of `bench/scenes/` by Mitsuba 3, which shares no code with us.

    bench/mitsuba_picture.py TREX SCENE.toml SPP FOLDER

Prints a document for `trex-bench record`. Reads model.trex in the folder, which stands for the scene's model. Writes
mitsuba.exr, and diffuse.toml, the scene that `trex render` is to make of it: Mitsuba has no modified Phong, so nothing
is glossy in either, and no surface is a mirror. Each material is exported as a mesh of its own; lamps of the model
shine on the side of their counter-clockwise face, as do rectangles. From behind these are black here, and not there at
all for us: in both pictures they are moved back until all of the model is in front of them.
"""

import json
import pathlib
import subprocess
import sys
import tomllib

import mitsuba as mi
import numpy as np

trex, scene_path, spp, folder = sys.argv[1], pathlib.Path(sys.argv[2]), int(sys.argv[3]), pathlib.Path(sys.argv[4])
mi.set_variant("scalar_rgb")
scene = tomllib.loads(scene_path.read_text())
model = (folder / "model.trex").resolve()
info = json.loads(subprocess.check_output([trex, "info", "--json", str(model)]))
width, height = scene["render"]["resolution"]
camera = scene["camera"]


def spectrum(values):
    return {"type": "rgb", "value": list(map(float, values))}


def behind(corner, normal):
    """The corner of a rectangle, moved back until a thousandth of the model's diagonal lies between them."""
    lo, hi = (np.array(info["bounds"][end]) for end in ("lo", "hi"))
    nearest = np.where(normal > 0.0, lo, hi)
    unit = normal / np.linalg.norm(normal)
    gap = np.dot(nearest - corner, unit) - 1e-3 * np.linalg.norm(hi - lo)
    return corner + min(gap, 0.0) * unit


described = {
    "type": "scene",
    "integrator": {"type": "path", "max_depth": 64, "rr_depth": 16},
    "sensor": {
        "type": "perspective",
        "fov": camera["fov_x"],
        "fov_axis": "x",
        "to_world": mi.ScalarTransform4f().look_at(
            origin=camera["position"], target=camera["target"], up=camera["up"]
        ),
        "film": {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"}},
        "sampler": {"type": "independent", "sample_count": spp},
    },
}
for index, light in enumerate(scene.get("light", [])):
    if light["type"] == "rect":
        u, v = np.array(light["edge_u"]), np.array(light["edge_v"])
        normal = np.cross(u, v)
        light["corner"] = behind(np.array(light["corner"]), normal).tolist()
        centre = np.array(light["corner"]) + 0.5 * (u + v)
        to_world = np.eye(4)
        to_world[:3, 0], to_world[:3, 1], to_world[:3, 2] = u / 2, v / 2, normal / np.linalg.norm(normal)
        to_world[:3, 3] = centre
        described[f"light_{index}"] = {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f(to_world.tolist()),
            "bsdf": {"type": "diffuse", "reflectance": spectrum([0, 0, 0])},
            "emitter": {"type": "area", "radiance": spectrum(light["radiance"])},
        }
    elif light["type"] == "sky":
        described[f"light_{index}"] = {"type": "constant", "radiance": spectrum(light["radiance"])}
    else:
        sys.exit(f"{scene_path}: a light of type {light['type']} is not translated")

lines = [f'model = "{model}"', "", "[camera]"]
lines += [f"{key} = {json.dumps(value)}" for key, value in camera.items()]
for light in scene.get("light", []):
    lines += ["", "[[light]]"] + [f"{key} = {json.dumps(value)}" for key, value in light.items()]
for index, name in enumerate(info["materials"]):
    mesh = folder / f"material-{index}.obj"
    command = [trex, "export", str(model), "--material", name, "-o", str(mesh), "--overwrite", "--progress", "none"]
    exported = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    # A material without triangles has no mesh.
    if exported.returncode and "no triangle" in exported.stderr:
        continue
    if exported.returncode:
        sys.exit(exported.stderr)
    values = {"Kd": [0.0] * 3, "Ke": [0.0] * 3}
    for key, *numbers in map(str.split, filter(str.strip, mesh.with_suffix(".mtl").read_text().splitlines())):
        if key in values:
            values[key] = list(map(float, numbers))
    lines += ["", f"[material.{json.dumps(name)}]", "ks = [0.0, 0.0, 0.0]", "mirror = false"]
    diffuse = {"type": "diffuse", "reflectance": spectrum(values["Kd"])}
    shape = {
        "type": "obj",
        "filename": str(mesh),
        "face_normals": True,
        "bsdf": {"type": "twosided", "bsdf": diffuse},
    }
    if any(values["Ke"]):
        shape["emitter"] = {"type": "area", "radiance": spectrum(values["Ke"])}
    described[f"shape_{index}"] = shape
lines += ["", "[render]", f"resolution = [{width}, {height}]", ""]
(folder / "diffuse.toml").write_text("\n".join(lines))
picture = mi.render(mi.load_dict(described))
mi.Bitmap(picture).convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32).write(str(folder / "mitsuba.exr"))
print(json.dumps({"scene": scene_path.name, "samples": spp, "mitsuba": mi.__version__}))

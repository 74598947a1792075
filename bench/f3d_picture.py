"""A picture of a mesh file by the library of f3d, without a window: bench/f3d_picture.py MESH PICTURE"""

import sys

import f3d

engine = f3d.Engine.create(offscreen=True)
engine.window.size = 512, 512
engine.scene.add(sys.argv[1])
engine.window.render_to_image().save(sys.argv[2])

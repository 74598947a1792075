"""The scene of a GLB again and again, side by side, as nodes that share its meshes.

    bench/instances.py IN.glb OUT.glb COPIES SIDE       SIDE: from one copy to the next
"""

import json
import struct
import sys

source, target, copies, side = sys.argv[1], sys.argv[2], int(sys.argv[3]), float(sys.argv[4])
with open(source, "rb") as file:
    glb = file.read()
end = 20 + struct.unpack("<I", glb[12:16])[0]
document, rest = json.loads(glb[20:end]), glb[end:]
nodes, scene = document["nodes"], document["scenes"][document.get("scene", 0)]


def clone(index):
    node = dict(nodes[index])
    if "children" in node:
        node["children"] = [clone(child) for child in node["children"]]
    nodes.append(node)
    return len(nodes) - 1


roots, row = scene["nodes"], []
for copy in range(copies):
    # A node has one parent.
    children = roots if copy == 0 else [clone(root) for root in roots]
    nodes.append({"translation": [side * (copy % 6), side * (copy // 6), 0.0], "children": children})
    row.append(len(nodes) - 1)
scene["nodes"] = row
text = json.dumps(document, separators=(",", ":")).encode()
text += b" " * (-len(text) % 4)
with open(target, "wb") as file:
    file.write(glb[:8] + struct.pack("<I", 20 + len(text) + len(rest)))
    file.write(struct.pack("<I4s", len(text), b"JSON") + text + rest)

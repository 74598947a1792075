#!/bin/sh
# Volumes beside scikit-image: bench/volume.sh FOLDER [SIDE [PERIODS]]
#
# Writes SIDE^3 floats (512) to FOLDER, a gyroid of PERIODS (8) periods within a ball, which is a closed surface, and races the
# reader of volumes, which reads the file, against scikit-image's marching cubes, which has it in memory: three rounds of
# each, in turn. PYTHON names an interpreter with numpy and scikit-image.
set -eu
folder=${1:?a folder for the volume, 4 bytes for each sample} side=${2:-512} periods=${3:-8} python=${PYTHON:-python3}
cargo build --quiet --release -p trex-store --example read_speed
"$python" - "$side" "$periods" "$folder/volume.raw" <<'END'
import sys
import numpy as np
side, periods = int(sys.argv[1]), float(sys.argv[2])
at = np.arange(side, dtype=np.float32) - (side - 1) / 2
wave, squared = np.float32(2 * np.pi * periods / side) * at, at * at
sine, cosine = np.sin(wave), np.cos(wave)
with open(sys.argv[3], "wb") as out:
    for k in range(side):
        gyroid = sine[None, :] * cosine[:, None] + sine[:, None] * cosine[k] + sine[k] * cosine[None, :]
        ball = 0.47 * side - np.sqrt(squared[None, :] + squared[:, None] + squared[k])
        np.minimum(gyroid, 0.05 * ball).astype("<f4").tofile(out)
END
printf 'NRRD0004\ntype: float\ndimension: 3\nsizes: %s %s %s\nendian: little\nencoding: raw\ndata file: volume.raw\n' \
    "$side" "$side" "$side" > "$folder/volume.nhdr"
for round in 1 2 3; do
    "${CARGO_TARGET_DIR:-target}/release/examples/read_speed" "$folder/volume.nhdr" 0 0
    "$python" - "$side" "$folder/volume.raw" <<'END'
import sys
import time
import resource
import numpy as np
from skimage.measure import marching_cubes
side = int(sys.argv[1])
volume = np.fromfile(sys.argv[2], "<f4").reshape(side, side, side)
for method in ["lewiner", "lorensen"]:
    start = time.perf_counter()
    faces = marching_cubes(volume, 0.0, method=method)[1]
    seconds = time.perf_counter() - start
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss >> 10
    print(f"scikit-image {method}: {len(faces) / seconds / 1e6:.1f} M triangles/s, {len(faces)} triangles, {peak} MiB at most")
END
done

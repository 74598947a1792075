#!/usr/bin/env bash
# What a user sees after a jump, 80, 200 and 1,000 ms after it and at leisure, on four kinds of model: the pictures of docs/view.md.
# A quarter of an hour, most of it references. Needs Python with venv, and PyPI.
#
#   bench/first_second.sh WORK_FOLDER
set -euo pipefail
work=$(realpath "${1:?usage: bench/first_second.sh WORK_FOLDER}")
cd "$(dirname "$0")/.."
root=$PWD
cargo build --release -q -p trex
source bench/record.sh
cd "$work"
build_kinds
cp "$root/bench/scenes/pipes-100m-inside-views.toml" .
if [ ! -e sheet-venv ]; then
    python3 -m venv sheet-venv
    sheet-venv/bin/pip install -q pillow
fi

folders=()
for model in isosurface-100m pipes-100m kicad-grid scan-100m; do
    [ -e $model.trex ] || continue
    folder=seen-$model
    views=()
    [ $model != pipes-100m ] || views=(--views pipes-100m-inside-views.toml)
    mkdir -p $folder
    # A verdict of no ends nothing.
    "$trex" stress $model.trex --scenario flip "${views[@]}" --switches 4 --hold 3200 --memory-limit 256MiB --resolution 1280x720 \
        --reference-spp 64 --references "${model%-100m}.references" --pictures $folder --overwrite --progress none >/dev/null || true
    folders+=($folder)
done

sheet-venv/bin/python - "$root/docs/pictures/first-second.jpg" "${folders[@]}" <<'PYTHON'
# Rows of models, columns of times; each picture reduced.
import sys
from PIL import Image

output, *folders = sys.argv[1:]
size = (360, 203)
names = ["80-ms", "200-ms", "1000-ms", "reference"]
sheet = Image.new("RGB", (len(names) * size[0], len(folders) * size[1]))
for row, folder in enumerate(folders):
    for column, name in enumerate(names):
        picture = Image.open(f"{folder}/{name}.png").resize(size, Image.LANCZOS)
        sheet.paste(picture, (column * size[0], row * size[1]))
sheet.save(output, quality=75)
PYTHON

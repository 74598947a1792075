# Copies of an OBJ file on a grid in its two longest directions, 1.1 extents apart: `awk -v copies=20 -f bench/grid.awk
# model.obj model.obj > grid.obj` (the file is read twice). Faces are of vertex indices alone, or i/j/k with the same.
NR == FNR {
    if ($1 == "v") {
        count++
        for (a = 1; a <= 3; a++) {
            x[count, a] = $(a + 1)
            if (count == 1 || $(a + 1) < lo[a]) lo[a] = $(a + 1)
            if (count == 1 || $(a + 1) > hi[a]) hi[a] = $(a + 1)
        }
    }
    next
}
FNR == 1 {
    thin = 1
    for (a = 2; a <= 3; a++) if (hi[a] - lo[a] < hi[thin] - lo[thin]) thin = a
    columns = int(sqrt(copies) + 0.999)
    for (k = 0; k < copies; k++) {
        place[0] = k % columns; place[1] = int(k / columns)
        for (i = 1; i <= count; i++) {
            line = "v"; n = 0
            for (a = 1; a <= 3; a++) line = line " " (a == thin ? x[i, a] : x[i, a] + 1.1 * (hi[a] - lo[a]) * place[n++])
            print line
        }
    }
}
$1 == "mtllib" { print }
$1 == "usemtl" || $1 == "f" { body[++lines] = $0 }
END {
    for (k = 0; k < copies; k++) {
        for (l = 1; l <= lines; l++) {
            if (substr(body[l], 1, 1) == "u") { print body[l]; continue }
            parts = split(body[l], word, " "); line = "f"
            for (p = 2; p <= parts; p++) { split(word[p], index_of, "/"); line = line " " index_of[1] + k * count }
            print line
        }
    }
}

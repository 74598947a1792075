"""The notebook runs from its first cell to its last, and the README's example does."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent


def test_the_notebook_runs(tmp_path):
    nbclient = pytest.importorskip("nbclient", reason="NOT RUN: nbclient is not installed")
    nbformat = pytest.importorskip("nbformat", reason="NOT RUN: nbformat is not installed")
    notebook = nbformat.read(ROOT / "examples" / "tour.ipynb", as_version=4)
    nbformat.validate(notebook)
    # Away from here, where the folder of the package would be imported.
    resources = {"metadata": {"path": str(tmp_path)}}
    nbclient.NotebookClient(notebook, timeout=300, kernel_name="python3", resources=resources).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    assert any("image/png" in output.get("data", {}) for output in outputs), "the model shows itself"
    assert not [output for output in outputs if output.output_type == "error"]


def test_the_readme_runs(tmp_path):
    text = (ROOT / "README.md").read_text()
    (code,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    environment = {**os.environ, "PYTHONPATH": ""}
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path, env=environment, check=True, timeout=300)

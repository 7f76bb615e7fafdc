"""Commands read tables without loading what only frames need."""

from __future__ import annotations

import subprocess
import sys

import pytest

SCRIPT = """
import sys
from photocal.base.tables import leave_pandas
leave_pandas()
import numpy as np
import pyarrow as pa
table = pa.table({"a": pa.array(np.arange(3.0)), "b": ["x", "y", "z"]})
print("pandas" in sys.modules)
print(table.to_pandas()["b"].tolist())
"""


def test_arrow_loads_pandas_only_for_a_frame() -> None:
    pytest.importorskip("pandas")
    said = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True)
    assert said.stdout.splitlines() == ["False", "['x', 'y', 'z']"]

"""What a run computes does not depend on which libraries were loaded before it."""

import subprocess
import sys

import pytest

_SCRIPT = """
import os
from feasigrasp.one_thread import one_thread
{before}
with one_thread():
    import scipy.linalg
    import torch
    from threadpoolctl import threadpool_info

    assert torch.get_num_threads() == 1
    assert {{pool["num_threads"] for pool in threadpool_info()}} == {{1}}
assert os.environ["OMP_NUM_THREADS"] == "3"
assert "OPENBLAS_NUM_THREADS" not in os.environ
"""


@pytest.mark.parametrize("before", ["", "import scipy.linalg, torch"])
def test_one_thread_whether_libraries_are_loaded_before_or_inside(before, monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    subprocess.run([sys.executable, "-c", _SCRIPT.format(before=before)], check=True)

"""What a run computes does not depend on which libraries were loaded before it."""

import subprocess
import sys
from importlib import import_module

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

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


@pytest.mark.parametrize("command", ["live", "perceive", "track"])
def test_a_command_computes_with_one_thread(command):
    class Begun(Exception):
        pass

    class Arguments:
        def __getattr__(self, name):
            raise Begun([pool["num_threads"] for pool in threadpool_info()])

    with threadpool_limits(2), pytest.raises(Begun) as caught:
        import_module(f"feasigrasp.commands.{command}").main(Arguments())
    assert set(caught.value.args[0]) == {1}

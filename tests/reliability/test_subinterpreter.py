"""A subinterpreter is refused at once, where pybind11 would wait for ever."""

from __future__ import annotations

import subprocess
import sys
import textwrap

PROGRAM = textwrap.dedent(
    """
    import faulthandler, importlib, sys
    faulthandler.dump_traceback_later(30, exit=True)
    try:
        interpreters = importlib.import_module("_interpreters")
    except ImportError:
        interpreters = importlib.import_module("_xxsubinterpreters")
    code = '''
    import sys
    sys.path[:] = {path!r}
    try:
        import manip3d
    except ImportError as error:
        assert "subinterpreter" in str(error), error
        print("refused", flush=True)
    '''
    import textwrap
    code = textwrap.dedent(code).replace("{path!r}", repr(sys.path))
    interpreters.run_string(interpreters.create(), code)
    import manip3d
    print("imported", manip3d.Mesh.__name__)
    """
)


def test_a_subinterpreter_is_refused_at_once() -> None:
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.stdout.split() == ["refused", "imported", "Mesh"], done.stderr

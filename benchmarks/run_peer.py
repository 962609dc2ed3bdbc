"""Run one peer on one mesh in this process, for one or more targets; meshes are pickled.

``python run_peer.py PEER MESH TARGET OUTPUT [TARGET OUTPUT ...]``

It prints a line of JSON for each target, with ``status`` ``ok`` (and the cost), ``not installed``
or ``refused``.
"""

from __future__ import annotations

import json
import pickle
import sys
from dataclasses import asdict
from pathlib import Path

from measuring import one_thread


def main(peer: str, mesh: str, *targets_and_outputs: str) -> None:
    """Run the peer and print its cost."""
    one_thread()  # must run before any library counts the cores
    from peers import PEERS, NotInstalledError, RefusedError

    original = pickle.loads(Path(mesh).read_bytes())
    for target_faces, output in zip(
        targets_and_outputs[::2], targets_and_outputs[1::2], strict=True
    ):
        try:
            result, cost = PEERS[peer].measured(original, int(target_faces))
        except NotInstalledError as error:
            said = {"status": "not installed", "message": str(error)}
        except RefusedError as error:
            said = {"status": "refused", "message": str(error)}
        else:
            Path(output).write_bytes(pickle.dumps(result))
            said = {"status": "ok", **asdict(cost)}
        print(json.dumps(said), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])

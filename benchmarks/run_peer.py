"""One peer, one mesh, one process: ``python run_peer.py PEER MESH TARGET OUTPUT`` (pickled meshes).

Prints one line of JSON: ``status`` is ``ok`` (with the cost), ``not installed`` or ``refused``.
"""

from __future__ import annotations

import json
import pickle
import sys
from dataclasses import asdict
from pathlib import Path

from measuring import one_thread


def main(peer: str, mesh: str, target_faces: str, output: str) -> None:
    """Run the peer and say what it cost."""
    one_thread()  # before any library counts the cores
    from peers import PEERS, NotInstalledError, RefusedError

    original = pickle.loads(Path(mesh).read_bytes())
    try:
        result, cost = PEERS[peer].measured(original, int(target_faces))
    except NotInstalledError as error:
        print(json.dumps({"status": "not installed", "message": str(error)}))
        return
    except RefusedError as error:
        print(json.dumps({"status": "refused", "message": str(error)}))
        return
    Path(output).write_bytes(pickle.dumps(result))
    print(json.dumps({"status": "ok", **asdict(cost)}))


if __name__ == "__main__":
    main(*sys.argv[1:])

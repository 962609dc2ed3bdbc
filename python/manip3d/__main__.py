"""``python -m manip3d`` is the command ``manip3d``."""

from manip3d._entry import main

if __name__ == "__main__":  # worker processes import this module under another name
    main()

"""What the verbs of ``manip3d`` do; `manip3d.cli` is their grammar."""

"""Registry of experiments: those of this package and those of plug-ins."""

from __future__ import annotations

import difflib
import importlib
from collections.abc import Iterable, Mapping
from functools import cache
from importlib.metadata import entry_points

from manip3d._util.checked import checked
from manip3d._util.mappings import ReadOnlyMapping
from manip3d.errors import InputError
from manip3d.experiments._model import Experiment

ENTRY_POINTS = "manip3d.experiments"
"""Group of entry points; each refers to an `Experiment`."""

_BUILT_IN = (
    "table_2_1",
    "table_2_2",
    "table_2_3",
    "table_2_4",
    "table_2_5",
    "table_2_6",
    "table_2_7",
    "figure_2_11",
    "figure_2_17",
    "ablation_boundary_weight",
    "ablation_seam_weight",
    "detector_3",
    "table_3_1",
    "table_3_2",
    "table_3_3",
    "table_3_4",
    "figure_3_5",
    "figure_3_6",
    "figure_3_7",
    "figure_3_8",
    "figure_3_10",
    "figure_3_12",
    "figure_3_13",
    "figure_3_14",
    "texture_3",
    "boundary_noise",
    "sequences_3",
    "readings_3",
    "table_4_1",
    "figure_4_3",
    "figure_4_4",
    "figure_4_6",
    "figure_4_11",
    "figure_4_13",
    "accuracy_4",
    "real_people_4",
    "cameras_5",
    "clouds_5",
    "figure_5_1",
    "figure_5_3",
    "figure_5_4",
    "figure_5_5",
    "figure_5_6",
    "figure_5_7",
    "figure_5_8",
    "timing_5",
    "jnd_simulated",
    "table_6_1",
    "table_6_2",
    "figure_6_3",
    "figure_6_4",
    "figure_6_5",
    "figure_6_6",
    "figure_6_7",
    "real_scans_6",
    "spoofing_6",
    "table_7_1",
    "table_7_2",
    "security",
    "cross_modal_7",
    "figure_7_7",
    "figure_7_8",
    "figure_7_10",
    "figure_7_12",
)


@cache
def registry() -> Mapping[str, Experiment]:
    """Return all experiments by id.

    Raises
    ------
    InputError
        Two experiments have the same id, or an entry point does not refer to an experiment.
    """
    modules = [importlib.import_module(f"manip3d.experiments.{name}") for name in _BUILT_IN]
    found: dict[str, Experiment] = {}
    plugins = (entry.load() for entry in entry_points(group=ENTRY_POINTS))
    for experiment in (*(module.EXPERIMENT for module in modules), *plugins):
        if not isinstance(experiment, Experiment):
            raise InputError(
                f"entry point {ENTRY_POINTS}: expected an Experiment, got {experiment!r:.80}"
            )
        if found.setdefault(experiment.id, experiment) is not experiment:
            raise InputError(f"experiment {experiment.id!r} is registered twice")
    return ReadOnlyMapping(found)


ALIASES = {"figure-7.9": "figure-7.10", "figure-7.11": "figure-7.12"}
"""Published figures that another figure's experiment draws: 7.9, scans before and after embedding,
and 7.11, attacks as seen by cameras and LiDAR."""


@checked
def _nearest(name: str, known: Iterable[str]) -> str:
    found = difflib.get_close_matches(name, list(known), n=3, cutoff=0.0)
    return ", ".join(found)


@checked
def select(ids: list[str]) -> list[Experiment]:
    """Return the experiments with these ids, in the registry's order; all for an empty list.

    An id in `ALIASES` selects the experiment that draws this figure, too.

    Parameters
    ----------
    ids : list of str
        Ids, as printed by ``manip3d reproduce --list``.

    Returns
    -------
    list of Experiment

    Raises
    ------
    InputError
        An id is not known.

    Examples
    --------
    >>> from manip3d import experiments
    >>> [each.id for each in experiments.select(["table-6.1", "table-2.1"])]
    ['table-2.1', 'table-6.1']
    """
    known = registry()
    wanted = [ALIASES.get(name, name) for name in ids]
    unknown = [name for name in wanted if name not in known]
    if unknown:
        raise InputError(
            f"experiment: expected an id such as {_nearest(unknown[0], known)} ('manip3d reproduce "
            f"--list' prints all of them), got {', '.join(unknown)}"
        )
    return [experiment for name, experiment in known.items() if not wanted or name in wanted]

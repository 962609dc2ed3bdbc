"""Studies with people: rating of forgeries, just noticeable differences, displays.

A local web server asks one question after another. Each participant has an order of their own,
which follows from a seed. Each answer is stored before the next step is shown, and a participant
who was interrupted continues at the same step.
"""

from __future__ import annotations

from manip3d.study._agreement import (
    Interval,
    fleiss_kappa,
    fleiss_kappa_interval,
    share_interval,
)
from manip3d.study._display import PUBLISHED_AGREE, DisplayStudy
from manip3d.study._engine import (
    Study,
    StudyReport,
    run_study,
    simulate_participants,
    state_of,
)
from manip3d.study._jnd import (
    JndLevel,
    JndModel,
    JndStudy,
    Rules,
    Staircase,
    make_jnd_stimuli,
    paired_power,
    required_participants,
    reversal_mean,
    simulate_staircase,
)
from manip3d.study._make import MadeStimuli, make_stimuli
from manip3d.study._psychometric import Estimate, SimulatedObserver, estimate_threshold
from manip3d.study._rating import (
    PUBLISHED_COMPOSITION,
    PUBLISHED_UNABLE_PERCENT,
    Item,
    RatingStudy,
)
from manip3d.study._reading import TEMPLATES, read_study, study_of, write_template
from manip3d.study._results import write_results
from manip3d.study._steps import Field, Step, Stimulus, px_per_degree
from manip3d.study._stimuli import copy_rating_stimuli, make_rating_stimuli
from manip3d.study._store import Answer, Session, StudyFolder

__all__ = [
    "PUBLISHED_AGREE",
    "PUBLISHED_COMPOSITION",
    "PUBLISHED_UNABLE_PERCENT",
    "TEMPLATES",
    "Answer",
    "DisplayStudy",
    "Estimate",
    "Field",
    "Interval",
    "Item",
    "JndLevel",
    "JndModel",
    "JndStudy",
    "MadeStimuli",
    "RatingStudy",
    "Rules",
    "Session",
    "SimulatedObserver",
    "Staircase",
    "Step",
    "Stimulus",
    "Study",
    "StudyFolder",
    "StudyReport",
    "copy_rating_stimuli",
    "estimate_threshold",
    "fleiss_kappa",
    "fleiss_kappa_interval",
    "make_jnd_stimuli",
    "make_rating_stimuli",
    "make_stimuli",
    "paired_power",
    "px_per_degree",
    "read_study",
    "required_participants",
    "reversal_mean",
    "run_study",
    "share_interval",
    "simulate_participants",
    "simulate_staircase",
    "state_of",
    "study_of",
    "write_results",
    "write_template",
]

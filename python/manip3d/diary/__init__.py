"""Digital diary of a study of phantom pain: sessions, games, ratings, questionnaires, analysis.

Research software, no medical device.
"""

from __future__ import annotations

from manip3d.diary._analysis import (
    DiaryAnalysis,
    Estimate,
    MixedModel,
    analyse,
    fit_mixed_model,
    simulate_cohort,
)
from manip3d.diary._clips import Clip, export_clips, film
from manip3d.diary._diary import Diary
from manip3d.diary._export import export_csv, export_fhir, fhir_bundle
from manip3d.diary._mcgill import MCGILL_GROUPS, McGillScore, score_mcgill
from manip3d.diary._page import write_overview, write_page
from manip3d.diary._protocol import SICKNESS, Adherence, Protocol, adherence, stop_reason
from manip3d.diary._questionnaires import (
    MCGILL,
    OWNERSHIP,
    Questionnaire,
    QuestionnaireItem,
    QuestionnaireScale,
    load_questionnaire,
    write_questionnaire,
)
from manip3d.diary._records import (
    AdverseEvent,
    Answers,
    DiaryGame,
    DiarySession,
    ExportedFile,
    FeltRecord,
    McGill,
    Ownership,
    Participant,
    Rating,
)
from manip3d.diary._rescue import DiaryRescue, rescue_diary
from manip3d.diary._sealing import make_key

__all__ = [
    "MCGILL",
    "MCGILL_GROUPS",
    "OWNERSHIP",
    "SICKNESS",
    "Adherence",
    "AdverseEvent",
    "Answers",
    "Clip",
    "Diary",
    "DiaryAnalysis",
    "DiaryGame",
    "DiaryRescue",
    "DiarySession",
    "Estimate",
    "ExportedFile",
    "FeltRecord",
    "McGill",
    "McGillScore",
    "MixedModel",
    "Ownership",
    "Participant",
    "Protocol",
    "Questionnaire",
    "QuestionnaireItem",
    "QuestionnaireScale",
    "Rating",
    "adherence",
    "analyse",
    "export_clips",
    "export_csv",
    "export_fhir",
    "fhir_bundle",
    "film",
    "fit_mixed_model",
    "load_questionnaire",
    "make_key",
    "rescue_diary",
    "score_mcgill",
    "simulate_cohort",
    "stop_reason",
    "write_overview",
    "write_page",
    "write_questionnaire",
]

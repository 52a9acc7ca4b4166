"""Monte Carlo studies: `dualslam study NAME`.  One file a study, one line here for each.

A study is a frozen dataclass: its fields are its options, its docstring is its help, calling it runs it.
"""

from __future__ import annotations

from app.study.association import AssociationStudy
from app.study.consistency import ConsistencyStudy
from app.study.corridor_spread import CorridorSpread
from app.study.diagnosis import DiagnosisStudy
from app.study.extraction import ExtractionStudy
from app.study.laser_log import LaserLog
from app.study.log_error import LogError
from app.study.loop_closure import LoopClosure
from app.study.mistakes import MistakesStudy
from app.study.orthogonality import OrthogonalityStudy
from app.study.paper_table import PaperTable
from app.study.rotation_spread import RotationSpread

STUDIES: dict[str, type] = {
    "paper-table": PaperTable,
    "log-error": LogError,
    "laser-log": LaserLog,
    "association": AssociationStudy,
    "loop-closure": LoopClosure,
    "corridor-spread": CorridorSpread,
    "rotation-spread": RotationSpread,
    "orthogonality": OrthogonalityStudy,
    "extraction": ExtractionStudy,
    "mistakes": MistakesStudy,
    "diagnosis": DiagnosisStudy,
    "consistency": ConsistencyStudy,
}

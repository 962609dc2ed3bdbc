"""Which public meshes stand in for the dissertation's models.

RockerArm and Head are the published files. Car, Dragon, Jet and Airplane are not public: meshes
with the same traits stand in for them, and every number measured on one says so.
"""

from __future__ import annotations

from dataclasses import dataclass

from manip3d.datasets._load import Cleaning


@dataclass(frozen=True)
class StandIn:
    """One mesh, in one cleaning, in the place of one of the dissertation's models.

    Attributes
    ----------
    published : str
        The dissertation's model; ``""`` for a mesh shown beside them.
    mesh : str
        Name for `manip3d.datasets.load_mesh`.
    cleaning : str
        One of `manip3d.datasets.CLEANINGS`.
    same_file : bool
        Whether it is the published file itself.
    textured : bool
        Whether it stands in the textured group (tables 2.3, 2.4 and 2.7).
    variant : str
        Tells several cleanings of one mesh apart.
    """

    published: str
    mesh: str
    cleaning: Cleaning = "stored"
    same_file: bool = False
    textured: bool = False
    variant: str = ""

    @property
    def label(self) -> str:
        """The mesh, and its variant where several are shown."""
        return f"{self.mesh}, {self.variant}" if self.variant else self.mesh

    @property
    def data(self) -> str:
        """``published``, ``stand-in`` or ``recorded``: in the place of nothing."""
        if self.same_file:
            return "published"
        return "stand-in" if self.published else "recorded"

    @property
    def role(self) -> str:
        """Role of its numbers: the published model's, a stand-in's, or a mesh's beside them."""
        if self.same_file:
            return f"the published {self.published}"
        return f"stand-in for {self.published}" if self.published else "beside the published models"


# As stored, the stand-ins have the share of boundary edges for which they were chosen; welded, as
# the command line simplifies them, stand beside those whose seams or sheets that changes most.
STAND_INS: tuple[StandIn, ...] = (
    StandIn("RockerArm", "rockerArm", same_file=True),
    StandIn("Car", "ferrari_458", variant="as stored"),
    StandIn("Car", "ferrari_458", "welded", variant="welded"),
    StandIn("Car", "ferrari_458", "any-unwelded", variant="one-sided"),
    StandIn("Car", "2CylinderEngine", variant="as stored"),
    StandIn("Car", "2CylinderEngine", "welded", variant="welded"),
    StandIn("Dragon", "lifeboat", variant="as stored"),
    StandIn("Dragon", "lifeboat", "welded", variant="welded"),
    StandIn("Dragon", "flash2a"),
    StandIn("Head", "LeePerrySmith", same_file=True, textured=True),
    StandIn("Jet", "BAe-125", textured=True),
    StandIn("Jet", "BAe-125-uv", textured=True),
    StandIn("Jet", "Cessna337", textured=True, variant="as stored"),
    StandIn("Jet", "Cessna337", "welded", textured=True, variant="welded"),
    StandIn("Airplane", "G-164A", textured=True),
    StandIn("Airplane", "M18B_Dromader", textured=True),
    StandIn("", "face_multitexture", textured=True),
    StandIn("", "chair", textured=True),
)

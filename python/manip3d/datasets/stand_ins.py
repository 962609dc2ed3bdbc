"""Public meshes that stand in for the dissertation's models.

RockerArm and Head are the published files. Car, Dragon, Jet and Airplane are not public. Meshes
with similar properties stand in for them, and each number measured on a stand-in is labelled so.
"""

from __future__ import annotations

from dataclasses import dataclass

from manip3d.datasets._load import Cleaning


@dataclass(frozen=True)
class StandIn:
    """A mesh with a cleaning that stands in for one of the dissertation's models.

    Attributes
    ----------
    published : str
        Name of the dissertation's model; ``""`` for an additional mesh.
    mesh : str
        Name for `manip3d.datasets.load_mesh`.
    cleaning : str
        One of `manip3d.datasets.CLEANINGS`.
    same_file : bool
        Whether the mesh is the published file itself.
    textured : bool
        Whether the mesh belongs to the textured group (tables 2.3, 2.4 and 2.7).
    variant : str
        Name of the cleaning if a mesh is shown with several; else ''.
    """

    published: str
    mesh: str
    cleaning: Cleaning = "stored"
    same_file: bool = False
    textured: bool = False
    variant: str = ""

    @property
    def label(self) -> str:
        """Name of the mesh, with its variant if it has one."""
        return f"{self.mesh}, {self.variant}" if self.variant else self.mesh

    @property
    def data(self) -> str:
        """Kind of the data: ``published``, ``stand-in`` or ``recorded`` (an additional mesh)."""
        if self.same_file:
            return "published"
        return "stand-in" if self.published else "recorded"

    @property
    def role(self) -> str:
        """Role in words: the published model, a stand-in for one, or an additional mesh."""
        if self.same_file:
            return f"the published {self.published}"
        return f"stand-in for {self.published}" if self.published else "beside the published models"


# The stand-ins were chosen by their share of boundary edges as stored. The command line welds
# meshes before it simplifies them; meshes that welding changes most are listed welded as well.
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

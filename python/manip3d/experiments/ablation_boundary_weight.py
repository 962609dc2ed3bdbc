"""Dependence of QEM4VR on its boundary weight W_b, in both readings of the curvature."""

from __future__ import annotations

from manip3d.experiments._ablation import weight_ablation

EXPERIMENT = weight_ablation(
    id="ablation-boundary-weight",
    titles={"curvature": "curvature"},
    title="QEM4VR at boundary weights 1, 5, 25 and 1000",
    option="boundary_weight",
    symbol="boundary weight",
    weights=(1.0, 5.0, 25.0, 1000.0),
    readings=({"curvature": "turning"}, {"curvature": "paper"}),
    meshes={
        "full": ("2CylinderEngine", "lifeboat", "flash2a", "BAe-125", "G-164A", "car", "jet"),
        "quick": ("lifeboat", "jet"),
    },
    measures={"metro_vertex": 1e3},
    source_value=5.0,
    note=(
        "The source names 5 as most suitable without numbers. Curvature 'turning' has another "
        "unit than the printed formula, so its best weight may be another."
    ),
)

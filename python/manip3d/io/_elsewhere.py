"""Formats that manip3d does not read, and programs that convert them."""

from __future__ import annotations

from pathlib import Path

_MESHES = {
    "Blender": ".blend .fbx .usd .usda .usdc .usdz .x3d .wrl .3ds .abc .lwo .x .ac .b3d .md2",
    "a CAD program": ".step .stp .iges .igs .brep .sat .x_t .sldprt .f3d .ifc .dwg .dxf .3dm .skp",
    "MeshLab or ParaView": ".vtk .vtp .vtu .msh .amf .ctm .mesh .meshb .wrl.gz .bre .u3d",
}
"""Programs that export a mesh from files with these suffixes."""

_ARCHIVES = (".zip", ".zae", ".kmz", ".7z", ".rar", ".tar", ".tgz")
"""Suffixes of archives in which meshes are passed on, with their textures."""

_SCANS = {
    ".lvx": (
        "save this recording of a Livox scanner as .las or .csv in Livox Viewer, or make a ROS bag "
        "of it with lvx_to_rosbag.launch of livox_ros_driver"
    ),
    ".lvx2": "convert this recording of a Livox scanner to .pcd in Livox Viewer 2",
    ".feather": (
        "write its columns x, y, z, intensity (and laser_number as ring) as .npz or .ply: "
        "pandas.read_feather reads the sweeps of Argoverse 2"
    ),
    **dict.fromkeys(
        (".h5", ".hdf5"),
        "write its columns x, y, z, intensity as .npz (arrays xyz and intensity) or .ply: h5py "
        "reads it",
    ),
    ".tsv": "name it .csv: columns of text may have tabs between them",
    ".pkl": (
        "unpickling can run any program: write its columns x, y, z, i as .npz or .ply; "
        "pandas.read_pickle reads the sweeps of PandaSet"
    ),
    **dict.fromkeys(
        (".tfrecord", ".parquet"),
        "write the range images or points as .npy or .npz with the tools of the Waymo Open Dataset",
    ),
    ".pnts": "use the .las, .laz or .e57 file that this tile of 3D Tiles was made of",
    **dict.fromkeys(
        (".fls", ".fws", ".zfs", ".zfc", ".rxp", ".rdb", ".rdbx", ".rcs", ".rcp", ".tzf"),
        "export it as .e57, .ptx or .las in the program of its scanner",
    ),
}
"""Advice on the conversion of point clouds with these suffixes to a format that is read."""


_ARRAY = "write its array as .npy with numpy.save"
_HDF5 = f"{_ARRAY}: h5py.File(FILE)[NAME][()] reads it"
_HYPERSIM = " (for Hypersim, whose distances are those along the lines of sight, give --ray-depth)"
_COLMAP = f"{_ARRAY}: read_array in COLMAP's scripts/python/read_write_dense.py reads it"
_DEPTHS = {
    ".h5": _HDF5,
    ".hdf5": _HDF5,
    ".mat": f"{_ARRAY}: scipy.io.loadmat(FILE)[NAME] reads it, or h5py in version 7.3",
    ".geometric.bin": _COLMAP,
    ".photometric.bin": _COLMAP,
}
"""Advice on the conversion of depth images with these endings to a format that is read."""


def mesh_advice(path: Path) -> str:
    """Return advice on how to convert an unsupported mesh format, after a semicolon; or ""."""
    suffix = "".join(path.suffixes[-2:]).lower().removesuffix(".gz").removesuffix(".xz")
    if suffix.endswith(_ARCHIVES):
        return "; unpack this archive first, and open the mesh in it"
    for program, suffixes in _MESHES.items():
        if Path("a" + suffix).suffix in suffixes.split():
            return f"; open it in {program} and export a mesh, as .glb with textures"
    return ""


def scan_advice(path: Path) -> str | None:
    """Return why a point cloud's format is not read, and the cure; None for other suffixes."""
    suffix = Path(path.name.lower().removesuffix(".xz").removesuffix(".gz")).suffix
    return f"manip3d does not read {suffix}; {_SCANS[suffix]}" if suffix in _SCANS else None


def with_depth_advice(advice: str | None, path: Path, *, takes_ray_depth: bool) -> str | None:
    """Return advice on a scan's format followed by how to convert a depth image of that name.

    Parameters
    ----------
    advice : str or None
        Result of `scan_advice`; None: the command takes no scans, or their formats have another
        suffix.
    path : Path
        The file.
    takes_ray_depth : bool
        Whether the command has the option ``--ray-depth``.
    """
    for ending, cure in _DEPTHS.items():
        if path.name.lower().endswith(ending):
            more = _HYPERSIM if takes_ray_depth and cure == _HDF5 else ""
            if advice is None:
                return f"manip3d does not read {ending}; {cure}{more}"
            return f"{advice}. If it holds a depth image, {cure}{more}"
    return advice

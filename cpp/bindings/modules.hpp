#pragma once

#include <pybind11/pybind11.h>

/// One function per file of this folder. module.cpp calls them all.
namespace manip3d::bindings {

void bind_depth(pybind11::module_& m);
void bind_geometry(pybind11::module_& m);
void bind_io(pybind11::module_& m);
void bind_lattice(pybind11::module_& m);
void bind_relief(pybind11::module_& m);
void bind_simplify(pybind11::module_& m);
void bind_metrics(pybind11::module_& m);
void bind_range_image(pybind11::module_& m);
void bind_depth_sampling(pybind11::module_& m);
void bind_rgbd(pybind11::module_& m);
void bind_avatar(pybind11::module_& m);
void bind_rgbd_capture(pybind11::module_& m);
void bind_capture(pybind11::module_& m);
void bind_scans(pybind11::module_& m);
void bind_forge(pybind11::module_& m);
void bind_authenticate(pybind11::module_& m);
void bind_modify(pybind11::module_& m);
void bind_watermark(pybind11::module_& m);
void bind_streams(pybind11::module_& m);
void bind_cross_modal(pybind11::module_& m);
void bind_serve(pybind11::module_& m);

}  // namespace manip3d::bindings

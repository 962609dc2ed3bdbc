#pragma once

#include <pybind11/pybind11.h>
#include <pybind11/typing.h>

#include <algorithm>
#include <cstddef>

#include "numpy.hpp"

/// @file
/// Python classes in the signatures of bindings. They only set the annotation, which the stub
/// contains for mypy: any object with the attributes that a binding reads is accepted.
namespace manip3d::bindings {

/// The text of an annotation.
template <std::size_t kSize>
struct TypeName {
  char text[kSize] = {};
  consteval TypeName(const char (&name)[kSize]) { std::copy_n(name, kSize, text); }
};

constexpr bool is_anything(const PyObject* /*object*/) { return true; }

/// An object of any class, with the annotation `kName` in signatures.
template <TypeName kName>
class Named : public py::object {
 public:
  PYBIND11_OBJECT_DEFAULT(Named, py::object, is_anything)
};

using Fields = py::typing::Dict<py::str, py::object>;
using Counts = py::typing::Dict<py::str, std::int64_t>;
using Texts = py::typing::Dict<py::str, py::str>;

using PyMesh = Named<"manip3d.mesh.Mesh">;
using PyIntrinsics = Named<"manip3d.camera.Intrinsics">;
using PyRegistration = Named<"manip3d.camera.Registration">;
using PySkeleton = Named<"manip3d.rgbd.Skeleton">;
using PyRgbdFrame = Named<"manip3d.rgbd.RgbdFrame">;
using PyProgress = Named<"collections.abc.Callable[[float], object] | None">;
using OptionalPyIntrinsics = Named<"manip3d.camera.Intrinsics | None">;
using OptionalPyRegistration = Named<"manip3d.camera.Registration | None">;
using OptionalPyCalibration = Named<"manip3d.rgbd.RgbdCalibration | None">;
using OptionalPySkeleton = Named<"manip3d.rgbd.Skeleton | None">;
using OptionalFields = Named<"dict[str, typing.Any] | None">;
using FieldsOrBool = Named<"dict[str, typing.Any] | bool">;
using VerticesAndSkeleton = Named<"tuple[numpy.ndarray, dict[str, typing.Any]] | None">;

}  // namespace manip3d::bindings

template <manip3d::bindings::TypeName kName>
struct pybind11::detail::handle_type_name<manip3d::bindings::Named<kName>> {
  static constexpr auto name = const_name(kName.text);
};

#include <pybind11/pybind11.h>

#include <cerrno>
#include <exception>
#include <filesystem>
#include <string>
#include <system_error>

#include "manip3d/error.hpp"
#include "modules.hpp"

namespace py = pybind11;

namespace {

// Decodes text of messages, which may quote any bytes of files and of their names.
py::str text(const std::string& bytes, const char* otherwise) {
  PyObject* decoded =
      PyUnicode_DecodeUTF8(bytes.data(), static_cast<py::ssize_t>(bytes.size()), otherwise);
  if (decoded == nullptr) throw py::error_already_set();
  return py::reinterpret_steal<py::str>(decoded);
}

py::str message(const std::exception& error) { return text(error.what(), "backslashreplace"); }

// A file name as Python has it: `os.fsencode` returns the same bytes.
py::str file_name(const std::string& bytes) { return text(bytes, "surrogateescape"); }

void raise(const char* type, const std::exception& error) {
  const py::object cls = py::module_::import("manip3d.errors").attr(type);
  PyErr_SetObject(cls.ptr(), message(error).ptr());
}

void raise(const manip3d::FormatError& error) {
  const auto none_or = [](const auto& value) -> py::object {
    return value ? py::object(py::int_(*value)) : py::object(py::none());
  };
  const py::object cls = py::module_::import("manip3d.errors").attr("FormatError");
  const py::object instance =
      cls(text(error.reason(), "backslashreplace"), py::arg("file") = file_name(error.file()),
          py::arg("line") = none_or(error.position().line),
          py::arg("byte_offset") = none_or(error.position().byte_offset));
  PyErr_SetObject(cls.ptr(), instance.ptr());
}

void translate(std::exception_ptr pointer) {
  try {
    if (pointer) std::rethrow_exception(pointer);
  } catch (const manip3d::FormatError& error) {
    raise(error);
  } catch (const manip3d::InputError& error) {
    raise("InputError", error);
  } catch (const manip3d::DeviceError& error) {
    raise("DeviceError", error);
  } catch (const manip3d::Error& error) {
    raise("Error", error);
    // becomes FileNotFoundError and the like
  } catch (const std::filesystem::filesystem_error& error) {
    const py::object instance = py::reinterpret_borrow<py::object>(PyExc_OSError)(
        error.code().value(), error.code().message(), file_name(error.path1().string()));
    PyErr_SetObject(reinterpret_cast<PyObject*>(Py_TYPE(instance.ptr())), instance.ptr());
    // an error of a file becomes FileNotFoundError and the like
  } catch (const std::system_error& error) {
    const py::object instance =
        py::reinterpret_borrow<py::object>(PyExc_OSError)(error.code().value(), message(error));
    PyErr_SetObject(reinterpret_cast<PyObject*>(Py_TYPE(instance.ptr())), instance.ptr());
  }
}

}  // namespace

PYBIND11_MODULE(_core, m) {
  m.doc() = "C++ core of manip3d. Private: use the typed functions of the package.";
  m.attr("__version__") = MANIP3D_VERSION;
  py::register_exception_translator(&translate);
  manip3d::bindings::bind_depth(m);
  manip3d::bindings::bind_geometry(m);
  manip3d::bindings::bind_io(m);
  manip3d::bindings::bind_lattice(m);
  manip3d::bindings::bind_relief(m);
  manip3d::bindings::bind_simplify(m);
  manip3d::bindings::bind_metrics(m);
  manip3d::bindings::bind_range_image(m);
  manip3d::bindings::bind_depth_sampling(m);
  manip3d::bindings::bind_rgbd(m);
  manip3d::bindings::bind_avatar(m);
  manip3d::bindings::bind_rgbd_capture(m);
  manip3d::bindings::bind_capture(m);
  manip3d::bindings::bind_scans(m);
  manip3d::bindings::bind_forge(m);
  manip3d::bindings::bind_authenticate(m);
  manip3d::bindings::bind_modify(m);
  manip3d::bindings::bind_watermark(m);
  manip3d::bindings::bind_streams(m);
  manip3d::bindings::bind_cross_modal(m);
  manip3d::bindings::bind_serve(m);
}

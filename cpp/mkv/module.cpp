#include <Python.h>

#include "ffmpeg.hpp"

// The extension module manip3d._mkv. It contains only the function table for _core, so that a
// machine without FFmpeg's libraries lacks Matroska recordings and nothing else.
namespace {

PyModuleDef definition = {PyModuleDef_HEAD_INIT,
                          "_mkv",
                          "Codec and muxer of recordings.",
                          0,
                          nullptr,
                          nullptr,
                          nullptr,
                          nullptr,
                          nullptr};

}  // namespace

PyMODINIT_FUNC PyInit__mkv() {
  PyObject* module = PyModule_Create(&definition);
  if (module == nullptr) return nullptr;
  auto* table = const_cast<manip3d::MkvCodec*>(&manip3d::ffmpeg_mkv_codec());
  PyObject* capsule = PyCapsule_New(table, "manip3d._mkv.codec", nullptr);
  if (PyModule_AddObjectRef(module, "codec", capsule) != 0) Py_CLEAR(module);
  Py_XDECREF(capsule);
  return module;
}

#pragma once

#include <filesystem>
#include <string>

#include "numpy.hpp"

namespace manip3d::bindings {

/// Text for the operating system, which would cut it at the first NUL.
/// @throws InputError  the text has a NUL.
inline std::string to_c_text(const py::bytes& bytes, const char* name) {
  std::string text = bytes;
  const std::size_t end = text.find('\0');
  if (end == std::string::npos) return text;
  throw InputError(std::string(name) + ": expected no NUL character, got one after '" +
                   text.substr(0, end) + "'");
}

/// Paths are passed as bytes (os.fsencode), because file names need not be UTF-8.
inline std::filesystem::path to_path(const py::bytes& bytes, const char* name) {
  return to_c_text(bytes, name);
}

}  // namespace manip3d::bindings

#include <pybind11/stl.h>

#include <optional>
#include <string>

#include "manip3d/serve/stream_frame.hpp"
#include "modules.hpp"
#include "numpy.hpp"

namespace manip3d::bindings {
namespace {

template <typename T>
std::span<const T> values(const CArray<T>& array, const char* name, py::ssize_t columns) {
  const bool fits =
      columns == 1 ? array.ndim() == 1 : array.ndim() == 2 && array.shape(1) == columns;
  if (!fits) {
    throw InputError(std::string(name) + ": expected shape (N" +
                     (columns == 1 ? "" : ", " + std::to_string(columns)) + ")");
  }
  return {array.data(), static_cast<std::size_t>(array.size())};
}

StreamImage to_image(const std::optional<CArray<std::uint8_t>>& image, const char* name) {
  if (!image) return {};
  if (image->ndim() != 3 || image->shape(2) != 3) {
    throw InputError(std::string(name) + ": expected shape (H, W, 3)");
  }
  return {image->data(), image->shape(0), image->shape(1)};
}

py::bytes encode(const CArray<float>& vertices, const CArray<float>& texcoords,
                 const CArray<std::uint8_t>& phantoms, const CArray<std::int32_t>& faces,
                 const std::optional<CArray<std::uint8_t>>& color,
                 const std::optional<CArray<std::uint8_t>>& phantom_color, float opacity,
                 std::uint32_t sequence, std::int64_t time_ns, std::int64_t captured_ns,
                 const std::string& status, int jpeg_quality) {
  StreamFrame frame;
  frame.vertices = values(vertices, "vertices", 3);
  frame.texcoords = values(texcoords, "texcoords", 2);
  frame.phantoms = values(phantoms, "phantoms", 1);
  frame.faces = values(faces, "faces", 3);
  frame.color = to_image(color, "color");
  frame.phantom_color = to_image(phantom_color, "phantom_color");
  frame.opacity = opacity;
  frame.sequence = sequence;
  frame.time_ns = time_ns;
  frame.captured_ns = captured_ns;
  frame.status = status;
  frame.jpeg_quality = jpeg_quality;
  std::vector<std::byte> message;
  {
    const py::gil_scoped_release nogil;
    message = encode_stream_frame(frame);
  }
  return {reinterpret_cast<const char*>(message.data()), message.size()};
}

}  // namespace

void bind_serve(py::module_& m) {
  m.def("encode_stream_frame", &encode, py::arg("vertices").noconvert(),
        py::arg("texcoords").noconvert(), py::arg("phantoms").noconvert(),
        py::arg("faces").noconvert(), py::arg("color").noconvert(),
        py::arg("phantom_color").noconvert(), py::arg("opacity"), py::arg("sequence"),
        py::arg("time_ns"), py::arg("captured_ns"), py::arg("status"), py::arg("jpeg_quality"));
}

}  // namespace manip3d::bindings

#include "manip3d/authenticate/watermark.hpp"

#include <pybind11/stl.h>
#include <pybind11/typing.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <limits>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "exclusive.hpp"
#include "manip3d/authenticate/paper_watermark.hpp"
#include "modules.hpp"
#include "paths.hpp"
#include "points.hpp"
#include "python_types.hpp"

namespace manip3d::bindings {
namespace {

py::bytes to_bytes(std::span<const std::uint8_t> bytes) {
  return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

std::vector<std::uint8_t> from_bytes(const py::bytes& bytes) {
  const std::string_view text(bytes);
  return {text.begin(), text.end()};
}

template <std::size_t kSize>
std::array<std::uint8_t, kSize> fixed(const py::bytes& bytes, const char* name) {
  const std::string_view text(bytes);
  if (text.size() != kSize) {
    throw InputError(std::string(name) + ": expected " + std::to_string(kSize) + " bytes, got " +
                     std::to_string(text.size()));
  }
  std::array<std::uint8_t, kSize> values;
  std::copy(text.begin(), text.end(), values.begin());
  return values;
}

WatermarkEmbedding to_embedding(int number) {
  if (number < 0 || number > 2) throw InputError("embedding: expected 0 to 2");
  return static_cast<WatermarkEmbedding>(number);
}

WatermarkOptions to_options(int embedding, int slices, int least_points, bool paper_merge,
                            bool round, std::uint32_t units_per_m = 1000) {
  return {to_embedding(embedding),
          slices,
          least_points,
          paper_merge ? WatermarkMerge::kPaper : WatermarkMerge::kAdjacent,
          round,
          units_per_m};
}

// Views an array (N, 3) of float64, or nothing.
ExactView exact_view(const std::optional<CArray<double>>& exact) {
  if (!exact) return {};
  if (exact->ndim() != 2 || exact->shape(1) != 3) throw InputError("exact: expected shape (N, 3)");
  return {exact->data(), static_cast<std::size_t>(exact->size())};
}

// Views an array (H, W) or (H, W, 3) of uint8, or nothing.
std::optional<PictureView> picture_view(const std::optional<CArray<std::uint8_t>>& picture) {
  if (!picture) return std::nullopt;
  const py::ssize_t most = std::numeric_limits<std::uint32_t>::max();
  const bool is_grey = picture->ndim() == 2;
  if (!(is_grey || picture->ndim() == 3) || picture->shape(0) > most || picture->shape(1) > most ||
      (!is_grey && picture->shape(2) != 3)) {
    throw InputError("picture: expected shape (H, W) or (H, W, 3)");
  }
  return PictureView{{picture->data(), static_cast<std::size_t>(picture->size())},
                     static_cast<std::uint32_t>(picture->shape(0)),
                     static_cast<std::uint32_t>(picture->shape(1)),
                     is_grey ? 1U : 3U};
}

using Embedder = Exclusive<WatermarkEmbedder>;
using Verifier = Exclusive<WatermarkVerifier>;
using Key = Exclusive<WatermarkKey>;

/// Points, record, number of the frame, number of tiles, exact points, picture.
using EmbeddedTuple = py::typing::Tuple<py::array_t<float>, py::bytes, std::uint64_t, int,
                                        py::array_t<double>, py::array_t<std::uint8_t>>;

EmbeddedTuple embed(Embedder& self, const CArray<float>& points, const CArray<float>& intensity,
                    std::int64_t time_ns, std::uint32_t num_dropped, bool is_end,
                    const std::optional<py::bytes>& context,
                    const std::optional<CArray<double>>& exact,
                    const std::array<std::int64_t, 3>& offset,
                    const std::optional<CArray<std::uint8_t>>& picture) {
  const PointsView view = points_view(points, intensity);
  const ExactView wide = exact_view(exact);
  WatermarkFrame frame{time_ns, num_dropped, is_end, std::nullopt, offset, picture_view(picture)};
  if (context) frame.context = fixed<32>(*context, "context");
  WatermarkedScan scan = self.with([&](WatermarkEmbedder& embedder) {
    const py::gil_scoped_release nogil;
    return embedder.embed(view, frame, wide);
  });
  const py::bytes record = to_bytes(scan.record);
  return py::make_tuple(to_numpy(std::move(scan.points)), record, scan.frame, scan.num_tiles,
                        to_numpy(std::move(scan.exact)), to_numpy(std::move(scan.picture)));
}

Fields to_fields(const WatermarkHeader& header) {
  Fields fields;
  fields["embedding"] = static_cast<int>(header.embedding);
  fields["carrier"] = static_cast<int>(header.carrier);
  fields["is_end"] = header.is_end;
  fields["has_context"] = header.has_context;
  fields["context"] = to_bytes(header.context);
  fields["sensor"] = to_bytes(header.sensor);
  fields["session"] = to_bytes(header.session);
  fields["frame"] = header.frame;
  fields["time_ns"] = header.time_ns;
  fields["has_intensity"] = header.has_intensity;
  fields["num_dropped"] = header.num_dropped;
  fields["is_exact"] = header.is_exact;
  fields["units_per_m"] = header.units_per_m;
  fields["offset"] = header.offset;
  fields["tile_of_slice"] = header.tile_of;
  return fields;
}

WatermarkPolicy to_policy(const std::vector<int>& embeddings, const std::vector<int>& carriers,
                          const std::vector<py::bytes>& sensors,
                          const std::vector<py::bytes>& sessions, std::int64_t max_points,
                          bool any_order, std::int64_t max_age_ns,
                          const std::optional<py::bytes>& context,
                          const std::vector<std::uint32_t>& units_per_m) {
  WatermarkPolicy policy;
  policy.units_per_m = units_per_m;
  policy.embeddings.clear();
  for (const int each : embeddings) policy.embeddings.push_back(to_embedding(each));
  policy.carriers.clear();
  for (const int each : carriers) policy.carriers.push_back(static_cast<std::uint8_t>(each));
  for (const py::bytes& each : sensors) policy.sensors.push_back(fixed<16>(each, "sensors"));
  for (const py::bytes& each : sessions) policy.sessions.push_back(fixed<16>(each, "sessions"));
  policy.max_points = max_points;
  policy.any_order = any_order;
  policy.max_age_ns = max_age_ns;
  if (context) policy.context = fixed<32>(*context, "context");
  return policy;
}

Fields to_fields(WatermarkFinding&& finding) {
  Fields fields;
  fields["verdict"] = static_cast<int>(finding.verdict);
  fields["reason"] = finding.reason;
  fields["content"] = static_cast<int>(finding.content);
  fields["order"] = static_cast<int>(finding.order);
  fields["gap"] = finding.gap;
  fields["freshness"] = static_cast<int>(finding.freshness);
  if (finding.header) {
    fields["header"] = to_fields(*finding.header);
  } else {
    fields["header"] = py::none();
  }
  fields["key"] = finding.key ? py::object(to_bytes(*finding.key)) : py::none();
  std::vector<int> tiles;
  for (const WatermarkTile tile : finding.tiles) tiles.push_back(static_cast<int>(tile));
  fields["tiles"] = py::cast(tiles);
  fields["rows"] = to_numpy(std::move(finding.rows));
  fields["tile_of_row"] = to_numpy(std::move(finding.tile_of_row));
  return fields;
}

Fields verify(Verifier& self, const CArray<float>& points, const CArray<float>& intensity,
              const py::bytes& record, const WatermarkPolicy& policy, std::uint32_t num_dropped,
              std::int64_t now_ns, const std::optional<CArray<double>>& exact,
              const std::optional<CArray<std::uint8_t>>& picture) {
  const PointsView view = points_view(points, intensity);
  const ExactView wide = exact_view(exact);
  const std::optional<PictureView> seen = picture_view(picture);
  const std::vector<std::uint8_t> bytes = from_bytes(record);
  WatermarkFinding finding = self.with([&](WatermarkVerifier& verifier) {
    const py::gil_scoped_release nogil;
    return verifier.verify(view, bytes, policy, num_dropped, now_ns, wide, seen);
  });
  return to_fields(std::move(finding));
}

PaperOptions to_paper_options(int embedding, int slices, int block_bits, bool paper_merge,
                              std::uint64_t key_2, std::uint32_t frame) {
  if (embedding < 0 || embedding > 2) throw InputError("embedding: expected 0 to 2");
  return {static_cast<PaperEmbedding>(embedding),
          slices,
          block_bits,
          paper_merge ? WatermarkMerge::kPaper : WatermarkMerge::kAdjacent,
          key_2,
          frame};
}

std::span<const std::uint8_t> values_of(const CArray<std::uint8_t>& array) {
  return {array.data(), static_cast<std::size_t>(array.size())};
}

std::unique_ptr<Embedder> make_embedder(Key& key, const py::bytes& sensor,
                                        const std::optional<py::bytes>& session, int embedding,
                                        int slices, int least_points, bool paper_merge, bool round,
                                        std::uint32_t units_per_m,
                                        const std::optional<py::bytes>& after) {
  const WatermarkId id = fixed<16>(sensor, "sensor");
  const WatermarkOptions options =
      to_options(embedding, slices, least_points, paper_merge, round, units_per_m);
  return key.with([&](const WatermarkKey& open) {
    if (after) {
      return std::make_unique<Embedder>(
          WatermarkEmbedder::after(from_bytes(*after), open, id, options));
    }
    return session ? std::make_unique<Embedder>(
                         WatermarkEmbedder(open, id, fixed<16>(*session, "session"), options))
                   : std::make_unique<Embedder>(WatermarkEmbedder(open, id, options));
  });
}

std::unique_ptr<Verifier> make_verifier(Key& key) {
  return key.with(
      [](const WatermarkKey& open) { return std::make_unique<Verifier>(WatermarkVerifier(open)); });
}

void add_older_key(Verifier& self, Key& key, std::int64_t replaced_ns) {
  key.with([&](const WatermarkKey& open) {
    self.with([&](WatermarkVerifier& verifier) { verifier.add_older_key(open, replaced_ns); });
  });
}

void bind_key(py::module_& m) {
  py::class_<Key>(m, "WatermarkKey")
      .def(py::init([](const py::bytes& path) {
             return std::make_unique<Key>(WatermarkKey(to_path(path, "path")));
           }),
           py::arg("path"))
      .def_static(
          "create",
          [](const py::bytes& path, std::int64_t created_ns, std::int64_t expires_ns) {
            WatermarkKey::create(to_path(path, "path"), created_ns, expires_ns);
          },
          py::arg("path"), py::arg("created_ns"), py::arg("expires_ns"))
      .def_property_readonly("id", [](Key& self) { return to_bytes(self.shared().id()); })
      .def_property_readonly("created_ns", [](Key& self) { return self.shared().created_ns(); })
      .def_property_readonly("expires_ns", [](Key& self) { return self.shared().expires_ns(); })
      .def_property_readonly(
          "is_open",
          [](Key& self) { return self.with([](WatermarkKey& key) { return key.is_open(); }); })
      .def("close", exclusively(&WatermarkKey::close));
}

void bind_embedder(py::module_& m) {
  py::class_<Embedder>(m, "WatermarkEmbedder")
      .def(py::init(&make_embedder), py::arg("key"), py::arg("sensor"), py::arg("session"),
           py::arg("embedding"), py::arg("slices"), py::arg("least_points"), py::arg("paper_merge"),
           py::arg("round"), py::arg("units_per_m") = 1000, py::arg("after") = py::none())
      .def("embed", &embed, py::arg("points").noconvert(), py::arg("intensity").noconvert(),
           py::arg("time_ns"), py::arg("num_dropped"), py::arg("is_end"), py::arg("context"),
           py::arg("exact").noconvert() = py::none(),
           py::arg("offset") = std::array<std::int64_t, 3>{},
           py::arg("picture").noconvert() = py::none())
      .def_property_readonly("session",
                             [](Embedder& self) {
                               return self.with([](const WatermarkEmbedder& embedder) {
                                 return to_bytes(embedder.session());
                               });
                             })
      .def("close", exclusively(&WatermarkEmbedder::close));
}

void bind_verifier(py::module_& m) {
  py::class_<WatermarkPolicy>(m, "WatermarkPolicy")
      .def(py::init(&to_policy), py::arg("embeddings"), py::arg("carriers"), py::arg("sensors"),
           py::arg("sessions"), py::arg("max_points"), py::arg("any_order"), py::arg("max_age_ns"),
           py::arg("context"), py::arg("units_per_m") = std::vector<std::uint32_t>{});

  py::class_<Verifier>(m, "WatermarkVerifier")
      .def(py::init(&make_verifier), py::arg("key"))
      .def("add_older_key", &add_older_key, py::arg("key"), py::arg("replaced_ns"))
      .def("verify", &verify, py::arg("points").noconvert(), py::arg("intensity").noconvert(),
           py::arg("record"), py::arg("policy"), py::arg("num_dropped"), py::arg("now_ns"),
           py::arg("exact").noconvert() = py::none(), py::arg("picture").noconvert() = py::none())
      .def("state",
           [](Verifier& self) {
             return to_bytes(
                 self.with([](const WatermarkVerifier& verifier) { return verifier.state(); }));
           })
      .def(
          "restore",
          [](Verifier& self, const py::bytes& state) {
            self.with([&](WatermarkVerifier& verifier) { verifier.restore(from_bytes(state)); });
          },
          py::arg("state"))
      .def("reset", exclusively(&WatermarkVerifier::reset))
      .def("close", exclusively(&WatermarkVerifier::close));
}

void bind_paper(py::module_& m) {
  py::class_<PaperOptions>(m, "PaperSettings")
      .def(py::init(&to_paper_options), py::arg("embedding"), py::arg("slices"),
           py::arg("block_bits"), py::arg("paper_merge"), py::arg("key_2"), py::arg("frame"));
  m.def(
      "embed_paper_watermark",
      [](const CArray<float>& points, const CArray<float>& intensity,
         const CArray<std::uint8_t>& blocks, const PaperOptions& options) {
        const PointsView view = points_view(points, intensity);
        const auto bits = values_of(blocks);
        PaperMarked marked;
        {
          const py::gil_scoped_release nogil;
          marked = embed_paper(view, bits, options);
        }
        return py::make_tuple(to_numpy(std::move(marked.points)),
                              to_numpy(std::move(marked.metadata.tile_of)),
                              to_numpy(std::move(marked.metadata.counts)));
      },
      py::arg("points").noconvert(), py::arg("intensity").noconvert(),
      py::arg("blocks").noconvert(), py::arg("options"));
  m.def(
      "compare_paper_watermark",
      [](const CArray<float>& points, const CArray<float>& intensity,
         const CArray<std::uint8_t>& blocks, const std::vector<std::uint16_t>& tile_of,
         const std::vector<std::uint32_t>& counts, const PaperOptions& options) {
        const PointsView view = points_view(points, intensity);
        const auto bits = values_of(blocks);
        PaperComparison found;
        {
          const py::gil_scoped_release nogil;
          found = compare_paper(view, bits, {tile_of, counts}, options);
        }
        return py::make_tuple(to_numpy(std::move(found.mismatches)),
                              to_numpy(std::move(found.and_mismatches)),
                              to_numpy(std::move(found.counts)), to_numpy(std::move(found.rows)));
      },
      py::arg("points").noconvert(), py::arg("intensity").noconvert(),
      py::arg("blocks").noconvert(), py::arg("tile_of"), py::arg("counts"), py::arg("options"));
}

void bind_order_and_pictures(py::module_& m) {
  m.def(
      "watermark_order",
      [](const CArray<float>& points, const CArray<float>& intensity, int embedding, int slices,
         int least_points) {
        const PointsView view = points_view(points, intensity);
        const WatermarkOptions options = to_options(embedding, slices, least_points, false, false);
        std::vector<std::int32_t> rows;
        {
          const py::gil_scoped_release nogil;
          rows = watermark_order(view, options);
        }
        return to_numpy(std::move(rows));
      },
      py::arg("points").noconvert(), py::arg("intensity").noconvert(), py::arg("embedding"),
      py::arg("slices"), py::arg("least_points"));
  m.def(
      "watermark_in_picture",
      [](const CArray<std::uint8_t>& picture) {
        return to_bytes(record_in(*picture_view(picture)));
      },
      py::arg("picture").noconvert());
  m.def(
      "without_watermark_record",
      [](const CArray<std::uint8_t>& picture) {
        return to_numpy(without_record(*picture_view(picture)));
      },
      py::arg("picture").noconvert());
}

}  // namespace

void bind_watermark(py::module_& m) {
  bind_key(m);
  bind_embedder(m);
  bind_verifier(m);
  bind_paper(m);
  bind_order_and_pictures(m);
}

}  // namespace manip3d::bindings

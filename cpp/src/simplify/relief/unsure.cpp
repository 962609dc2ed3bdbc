#include "simplify/relief/unsure.hpp"

#include <algorithm>

#include "simplify/relief/refine.hpp"

namespace manip3d::relief_detail {
namespace {

/// Visits the pixels that share a dense triangle with a pixel, some of them twice.
template <typename Visit>
void visit_joined(const Surface& surface, std::int32_t pixel, Visit&& visit) {
  const int u = surface.u(pixel), v = surface.v(pixel), cols = surface.cols();
  for (int cell_v = std::max(v - 1, 0); cell_v <= std::min(v, surface.rows() - 2); ++cell_v) {
    for (int cell_u = std::max(u - 1, 0); cell_u <= std::min(u, cols - 2); ++cell_u) {
      const std::int32_t a = cell_v * cols + cell_u;
      for (const bool second : {false, true}) {
        if ((surface.cell(a) & (second ? kSecond : kFirst)) == 0) continue;
        const auto corners = cell_triangle(surface.cell(a), second, a, cols);
        if (std::ranges::find(corners, pixel) == corners.end()) continue;
        for (const std::int32_t p : corners) {
          if (p != pixel && surface.is_used(p)) visit(p);
        }
      }
    }
  }
}

}  // namespace

/// Gathers the piece of a pixel in `piece_`, and stops as soon as it has too much confidence.
bool UnsurePieces::is_unsure(const Surface& surface, std::int32_t first, float least) {
  const double enough = double{least} * static_cast<double>(surface.num_used());
  double sum = 0.0;
  bool is_known = false;  // the piece was gathered before, and has enough
  piece_.assign(1, first);
  marks_[first] = kOwn;
  for (std::size_t i = 0; i < piece_.size() && sum < enough && !is_known; ++i) {
    sum += double{surface.confidence(piece_[i])};
    visit_joined(surface, piece_[i], [&](std::int32_t p) {
      is_known = is_known || marks_[p] == kDone;
      if (marks_[p] != kNew) return;
      marks_[p] = kOwn;
      piece_.push_back(p);
    });
  }
  for (const std::int32_t p : piece_) marks_[p] = kDone;
  return !is_known && sum < double{least} * static_cast<double>(piece_.size());
}

bool UnsurePieces::find(const PointGridView& grid, const Surface& surface) {
  pixels_.clear();
  const float least = surface.least_sure();
  if (!(least > 0.0F)) return false;
  marks_.assign(surface.num_pixels(), kNew);
  for (std::int32_t p = 0; p < static_cast<std::int32_t>(surface.num_pixels()); ++p) {
    if (!surface.is_used(p) || marks_[p] != kNew || surface.confidence(p) >= least) continue;
    if (is_unsure(surface, p, least)) pixels_.insert(pixels_.end(), piece_.begin(), piece_.end());
  }
  if (pixels_.empty()) return false;
  grid_ = grid;
  valid_.assign(grid.valid, grid.valid + grid.rows * grid.cols);
  for (std::int32_t& p : pixels_) {
    p = static_cast<std::int32_t>(surface.input_v(p) * grid.cols + surface.input_u(p));
    valid_[p] = 0;
  }
  std::ranges::sort(pixels_);
  grid_.valid = valid_.data();
  if (grid.rows * grid.cols > kManyPixels) {
    release(marks_);
    release(piece_);
  }
  return true;
}

void move_to_rims(const Surface& surface, Triangulation& mesh, std::span<const Keep> keep) {
  const auto is_unsure = [&](std::int32_t pixel) { return surface.is_unsure(pixel); };
  Triangulation::Fan fan;
  for (std::int32_t v = 0; v < mesh.num_slots(); ++v) {
    const Triangulation::Vertex& vertex = mesh.vertex(v);
    if (!vertex.alive() || vertex.on_boundary || !is_unsure(vertex.pixel) || !mesh.fan(v, fan) ||
        (!keep.empty() && keep[vertex.pixel] == Keep::kFixed)) {
      continue;
    }
    const std::int32_t to = Refiner::nearest_in(surface, mesh, fan, vertex.pixel, is_unsure);
    if (to >= 0) mesh.move(v, surface, to);
  }
}

}  // namespace manip3d::relief_detail

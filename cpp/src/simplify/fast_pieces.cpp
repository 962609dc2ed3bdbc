#include "simplify/fast_pieces.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "geometry/shared_union_find.hpp"
#include "manip3d/geometry/topology.hpp"

namespace manip3d::fast_detail {
namespace {

/// Distance of a piece from the rest, as a share of the size of the mesh, above which its removal
/// is obvious. Holes are closed before such a piece is removed.
constexpr double kMissedDistance = 0.01;

/// Factor on the price of removing a piece, which is more obvious than its distance suggests;
/// squared, like all prices.
constexpr double kFastPieceFactor = 4.0;

constexpr std::int64_t kFacesOfTetrahedron = 4;

/// Whether a piece with this many faces can only be removed as a whole.
bool is_spent_count(std::int64_t num_faces) {
  return num_faces == 1 || num_faces == kFacesOfTetrahedron;
}

}  // namespace

void FastPieces::find() {
  if (is_connected()) return;
  welded_.faces.resize(mesh_.num_faces(), 3);
  for (std::size_t f = 0; f < mesh_.faces.size(); ++f) {
    welded_.faces.row(static_cast<Eigen::Index>(f)) << mesh_.faces[f][0], mesh_.faces[f][1],
        mesh_.faces[f][2];
  }
  if (find_components(welded_.faces, mesh_.num_vertices()).count < 2) {
    welded_ = {};
    return;
  }
  welded_.vertices.resize(mesh_.num_vertices(), 3);
  for (std::int32_t v = 0; v < mesh_.num_vertices(); ++v) {
    welded_.vertices.row(v) = mesh_.input.vertices.row(mesh_.order.source[v]);
  }
  add_looks();
  view_.emplace(welded_);
  pieces_.emplace(*view_, mesh_.scale, looks_, mesh_.tasks.part(0.16, 0.2));
  count_faces();
  piece_weight_.assign(pieces_->size(), 0.0);
  for (std::int32_t v = 0; v < mesh_.num_vertices(); ++v) {
    const std::int32_t piece = pieces_->of_vertex(v);
    if (piece >= 0) piece_weight_[piece] += mesh_.vertices[v].weight;
  }
  is_kept_.assign(pieces_->size(), 0);
  for (std::size_t v = 0; v < mesh_.locked.size(); ++v) {
    const std::int32_t piece = pieces_->of_vertex(static_cast<std::int32_t>(v));
    if (mesh_.locked[v] != 0 && piece >= 0) is_kept_[piece] = 1;
  }
}

/// Adds the materials and the colours, by which pieces look different.
void FastPieces::add_looks() {
  if (mesh_.input.has_materials()) {
    welded_.face_material.resize(mesh_.num_faces());
    for (std::int32_t f = 0; f < mesh_.num_faces(); ++f) {
      welded_.face_material(f) = mesh_.input.face_material(mesh_.face_ids[f]);
    }
  }
  if (mesh_.input.colors.rows() == 0) return;
  welded_.colors.resize(mesh_.num_vertices(), 3);
  for (std::int32_t v = 0; v < mesh_.num_vertices(); ++v) {
    welded_.colors.row(v) = mesh_.input.colors.row(mesh_.order.source[v]);
  }
}

/// Whether all vertices are connected. Faster than find_components(), but a vertex without faces,
/// or whose faces have no area, counts as a component.
bool FastPieces::is_connected() const {
  SharedUnionFind sets(mesh_.num_vertices());
  mesh_.tasks.over(mesh_.num_faces(), kBlock, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t f = begin; f < end; ++f) {
      sets.join(mesh_.faces[f][0], mesh_.faces[f][1]);
      sets.join(mesh_.faces[f][1], mesh_.faces[f][2]);
    }
  });
  return sets.num_sets() < 2;
}

/// Counts the faces of each piece, and of all pieces that can only be removed as a whole.
void FastPieces::count_faces() {
  std::vector<std::int64_t>& count = faces_of_piece_;
  count.assign(pieces_->size(), 0);
  for (const Triple& face : mesh_.faces) ++count[piece_of(face)];
  num_spent_ = 0;
  for (std::int32_t i = 0; i < pieces_->size(); ++i) {
    pieces_->remove_faces(i, pieces_->num_faces(i) - count[i]);
    if (is_spent_count(count[i])) num_spent_ += count[i];
  }
}

bool FastPieces::is_spent(const Triple& face) const {
  const std::int64_t count = faces_of_piece_[piece_of(face)];
  return count == 1 || (count == kFacesOfTetrahedron && mesh_.is_open[face[0]] == 0);
}

/// Price of a piece in the unit of the prices of collapses: squared distance times the weight of
/// its planes (area, boundaries and seams), per two faces. At most `most_faces` count, because
/// removing more than the target needs has no value.
double FastPieces::price_of(std::int32_t i, std::int64_t most_faces) const {
  const double distance = pieces_->mean_distance(i);
  const double seen_as = distance + pieces_->wrong_look(i);
  const double look =
      kFastPieceFactor * pieces_->area(i) * (seen_as * seen_as - distance * distance);
  const double price = (kFastPieceFactor - 1.0) * pieces_->cost(i) * distance +
                       piece_weight_[i] * distance * distance + look;
  return price * 2.0 / static_cast<double>(std::min(most_faces, pieces_->num_faces(i)));
}

double FastPieces::cheapest_price(std::int64_t needed, double max_error) const {
  double least = std::numeric_limits<double>::infinity();
  for (std::int32_t i = 0; pieces_ && i < pieces_->size(); ++i) {
    if (!pieces_->is_there(i) || is_kept_[i] != 0) continue;
    if (mesh_.scale * pieces_->mean_distance(i) > max_error) continue;
    least = std::min(least, price_of(i, needed));
  }
  return least;
}

/// Queues the pieces that may be removed, the cheapest first.
FastPieces::Queue FastPieces::price_pieces(double limit, bool is_forced,
                                           std::int64_t most_faces) const {
  Queue queue;
  for (std::int32_t i = 0; i < pieces_->size(); ++i) {
    if (!pieces_->is_there(i) || is_kept_[i] != 0) continue;
    const double price = price_of(i, most_faces);
    if (std::isfinite(price) && (price <= limit || is_forced)) queue.emplace(price, i);
  }
  return queue;
}

std::int64_t FastPieces::remove(double limit, Choice choice, std::int64_t target,
                                double max_error) {
  if (!pieces_) return 0;
  const bool is_instead = choice == Choice::kInstead;
  const bool is_forced = choice != Choice::kCheap && !is_instead;
  count_faces();
  std::vector<std::int64_t>& count = faces_of_piece_;
  std::int64_t gone = 0;
  const auto most_faces = [&] {
    return is_instead ? mesh_.num_faces() - gone - target : mesh_.num_faces();
  };
  if (most_faces() <= 0) return 0;
  Queue queue = price_pieces(limit, is_forced, most_faces());
  std::vector<std::uint8_t> is_gone(pieces_->size(), 0);
  while (!queue.empty()) {
    const std::int32_t i = queue.top().second;
    queue.pop();
    const std::int64_t needed = mesh_.num_faces() - gone - target;
    if (needed <= 0) break;
    if (count[i] > needed && choice != Choice::kAny && !is_instead) continue;
    pieces_->refresh(i);
    const double now = price_of(i, most_faces());
    if (!std::isfinite(now)) continue;
    if (now > limit) {
      if (!is_forced || (choice == Choice::kAny && gone > 0)) continue;
      if (!queue.empty() && now > queue.top().first) {  // a piece that was near it is removed
        queue.emplace(now, i);
        continue;
      }
    }
    if (choice == Choice::kNear && pieces_->mean_distance(i) > kMissedDistance) continue;
    const double error = mesh_.scale * pieces_->mean_distance(i);
    if (error > max_error) {
      ++num_too_far_;
      continue;
    }
    error_ = std::max(error_, error);
    gone += count[i];
    pieces_->remove_faces(i, count[i]);
    if (is_spent_count(count[i])) num_spent_ -= count[i];
    is_gone[i] = 1;
    ++num_removed_;
  }
  if (gone == 0) return 0;
  mesh_.keep_faces([&](std::int32_t f) { return is_gone[piece_of(mesh_.faces[f])] == 0; });
  return gone;
}

}  // namespace manip3d::fast_detail

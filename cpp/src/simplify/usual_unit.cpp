#include "simplify/usual_unit.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <new>

#include "manip3d/error.hpp"

namespace manip3d {
namespace {

constexpr int kMaxExponent = 200;

/// The diagonal of a box, even if the squares of its sides overflow or underflow.
double diagonal_of(const BoundingBox& box) { return (box.max - box.min).stableNorm(); }

}  // namespace

UsualUnit::UsualUnit(const MeshView& mesh) : mesh_(mesh), box_(bounding_box(mesh)) {
  const double diagonal = diagonal_of(box_);
  if (!std::isfinite(diagonal)) {
    throw InputError(
        "vertices: expected a bounding box whose diagonal is a finite number, got infinity");
  }
  if (!(diagonal > 0.0)) return;
  const int exponent = std::ilogb(diagonal);
  const int usual = std::clamp(exponent, -kMaxExponent, kMaxExponent);
  if (exponent == usual) return;
  unit_ = std::ldexp(1.0, exponent - usual);
  vertices_ = mesh.vertices / unit_;
  box_ = {box_.min / unit_, box_.max / unit_};
  using Map = MeshView::Map<Vertices>;
  new (&mesh_.vertices) Map(vertices_.data(), vertices_.rows(), 3);  // Eigen's way to rebind a map
}

double UsualUnit::from_file(double length) const {
  if (!std::isfinite(length)) return length;
  return std::min(length / unit_, std::numeric_limits<double>::max());
}

}  // namespace manip3d

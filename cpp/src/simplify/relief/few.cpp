#include "simplify/relief/few.hpp"

#include <algorithm>
#include <limits>
#include <queue>

#include "simplify/relief/coverage.hpp"

namespace manip3d::relief_detail {
namespace {

Triangle corner_pixels(const Triangulation& mesh, std::int32_t t) {
  const auto [a, b, c] = mesh.triangle(t);
  return {mesh.vertex(a).pixel, mesh.vertex(b).pixel, mesh.vertex(c).pixel};
}

std::int64_t doubled_pixels_of(const Triangulation& mesh, std::int32_t t) {
  const auto [a, b, c] = mesh.triangle(t);
  return mesh.orient(a, b, c);
}

/// Chooses triangles one after the other, greedily.
class Chooser {
 public:
  Chooser(const Triangulation& mesh, std::int64_t most_vertices, FewFaces& chosen)
      : mesh_(mesh),
        room_(most_vertices),
        chosen_(chosen),
        states_(mesh.num_face_slots(), kOut),
        covered_(mesh.num_face_slots()) {}

  void offer(std::int32_t t, std::int64_t covered) {
    states_[t] = kOffered;
    covered_[t] = covered;
    push(t);
  }

  void choose() {
    while (!best_.empty()) {
      const Offer offer = best_.top();
      best_.pop();
      if (states_[offer.face] != kOffered || offer.cost != cost_of(offer.face)) continue;
      // Too expensive now; it may be offered again for less.
      if (offer.cost <= room_) take(offer.face);
    }
  }

 private:
  enum State : std::uint8_t { kOut, kOffered, kTaken };
  struct Offer {
    double rate;
    std::int32_t face;
    int cost;
    bool operator<(const Offer& other) const {
      return rate < other.rate || (rate == other.rate && face > other.face);
    }
  };

  /// Number of vertices that a triangle adds; one with two chosen neighbours connects their fans.
  [[nodiscard]] int cost_of(std::int32_t t) const {
    const auto beside = std::ranges::count_if(mesh_.neighbors(t), [this](std::int32_t n) {
      return n != Triangulation::kNone && states_[n] == kTaken;
    });
    return beside == 0 ? 3 : beside == 1 ? 1 : 0;
  }
  void push(std::int32_t t) {
    const int cost = cost_of(t);
    const auto pixels = static_cast<double>(covered_[t]);
    best_.push({cost > 0 ? pixels / cost : std::numeric_limits<double>::infinity(), t, cost});
  }
  void take(std::int32_t t) {
    room_ -= cost_of(t);
    states_[t] = kTaken;
    chosen_.corners.push_back(corner_pixels(mesh_, t));
    chosen_.covered += covered_[t];
    for (const std::int32_t n : mesh_.neighbors(t)) {
      if (n != Triangulation::kNone && states_[n] == kOffered) push(n);
    }
  }

  const Triangulation& mesh_;
  std::int64_t room_;
  FewFaces& chosen_;
  std::vector<State> states_;          ///< By face.
  std::vector<std::int64_t> covered_;  ///< By face: number of pixels that it covers.
  std::priority_queue<Offer> best_;
};

}  // namespace

FewFaces few_faces(const Surface& surface, const Triangulation& mesh, std::int64_t most_vertices) {
  FewFaces chosen;
  Chooser chooser(mesh, most_vertices, chosen);
  std::int32_t largest = Triangulation::kNone;
  for (std::int32_t t = 0; t < mesh.num_face_slots(); ++t) {
    if (!mesh.is_face(t)) continue;
    if (largest == Triangulation::kNone ||
        doubled_pixels_of(mesh, t) > doubled_pixels_of(mesh, largest)) {
      largest = t;
    }
    const Triangle pixels = corner_pixels(mesh, t);
    if (!lies_off(surface, pixels)) chooser.offer(t, covered_pixels(surface, pixels));
  }
  chooser.choose();
  if (chosen.corners.empty() && largest != Triangulation::kNone)
    chosen.corners = {corner_pixels(mesh, largest)};
  return chosen;
}

std::int64_t doubled_pixels(const Triangulation& mesh) {
  std::int64_t sum = 0;
  for (std::int32_t t = 0; t < mesh.num_face_slots(); ++t) {
    if (mesh.is_face(t)) sum += doubled_pixels_of(mesh, t);
  }
  return sum;
}

}  // namespace manip3d::relief_detail

#include "simplify/relief/blocks.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>

namespace manip3d::relief_detail {
namespace {

constexpr int kSize = ContourBlocks::kSize;
constexpr int kStride = kSize + 1;

/// Steps to the eight neighbours, counter-clockwise with v up.
constexpr std::array<int, 8> kAcross = {1, 1, 0, -1, -1, -1, 0, 1};
constexpr std::array<int, 8> kUp = {0, 1, 1, 1, 0, -1, -1, -1};
enum Direction : std::uint8_t {
  kRight,
  kRightUp,
  kTop,
  kLeftUp,
  kLeft,
  kLeftDown,
  kDown,
  kRightDown
};

// The corners of a cell as bits.
constexpr unsigned kA = 1, kB = 2, kC = 4, kD = 8;
/// By cell: corners that belong to one of its triangles.
constexpr std::array<std::uint8_t, 8> kTouched = {0, kA | kB | kD, kA | kC | kD, kA | kB | kC | kD,
                                                  0, kA | kB | kC, kB | kC | kD, kA | kB | kC | kD};
/// By cell: corners at which it lacks no triangle.
constexpr std::array<std::uint8_t, 8> kComplete = {0, kB, kC, kA | kB | kC | kD,
                                                   0, kA, kD, kA | kB | kC | kD};

constexpr int kPlaces = kStride * kStride;

constexpr std::uint32_t bit_at(int u, int v) { return 1U << (v * kStride + u); }

/// By two pixels of a square: those of its pixels that are left of the line through them or on it,
/// as bits.
constexpr std::array<std::array<std::uint32_t, kPlaces>, kPlaces> kLeftOf = [] {
  std::array<std::array<std::uint32_t, kPlaces>, kPlaces> left{};
  for (int a = 0; a < kPlaces; ++a) {
    for (int b = 0; b < kPlaces; ++b) {
      const int du = b % kStride - a % kStride, dv = b / kStride - a / kStride;
      for (int v = 0; v < kStride; ++v) {
        for (int u = 0; u < kStride; ++u) {
          if (du * (v - a / kStride) - dv * (u - a % kStride) >= 0) left[a][b] |= bit_at(u, v);
        }
      }
    }
  }
  return left;
}();

/// The inner pixels of a square, as bits.
constexpr std::uint32_t kInner = [] {
  std::uint32_t inner = 0;
  for (int v = 1; v < kSize; ++v) {
    for (int u = 1; u < kSize; ++u) inner |= bit_at(u, v);
  }
  return inner;
}();

/// The cells around a pixel.
struct CellsAround {
  CellsAround(const Surface& surface, int u, int v) {
    const int cols = surface.cols();
    const auto cell = [&](int column, int row) -> std::uint8_t {
      return column < 0 || row < 0 ? std::uint8_t{0} : surface.cell(row * cols + column);
    };
    low_left = cell(u - 1, v - 1), low_right = cell(u, v - 1);
    high_left = cell(u - 1, v), high_right = cell(u, v);
  }
  [[nodiscard]] bool are_complete() const {
    return ((kComplete[low_left] & kD) != 0) && ((kComplete[low_right] & kC) != 0) &&
           ((kComplete[high_left] & kB) != 0) && ((kComplete[high_right] & kA) != 0);
  }
  std::uint8_t low_left, low_right, high_left, high_right;
};

/// Two cells that meet at a pixel, on one side of a line through it.
struct HalfAround {
  HalfAround(std::uint8_t first, unsigned corner, std::uint8_t second, unsigned other_corner)
      : touches(((kTouched[first] & corner) | (kTouched[second] & other_corner)) != 0),
        is_complete((kComplete[first] & corner) != 0 && (kComplete[second] & other_corner) != 0) {}
  bool touches, is_complete;
};

/// Whether the contour of the surface on either side of a line turns or begins at a pixel. False if
/// the surface continues along the line on both sides, or on one side with nothing on the other.
bool turns_at_line(const CellsAround& cells, bool upright) {
  const HalfAround one(cells.low_left, kD, upright ? cells.high_left : cells.low_right,
                       upright ? kB : kC);
  const HalfAround other(upright ? cells.low_right : cells.high_left, upright ? kC : kB,
                         cells.high_right, kA);
  if (!one.touches && !other.touches) return false;
  return !((one.is_complete && (other.is_complete || !other.touches)) ||
           (other.is_complete && !one.touches));
}

/// A pixel at which a contour goes straight on in the image is a vertex if its distance in space
/// exceeds this many times the threshold. Of 1, 4 and 16, tried on scans and frames of the data
/// folder, 1 multiplies the error by 0.99 at 5 % of the points and by 1.04 at 0.5 %, because noise
/// makes vertices as well. 16 changes neither, and keeps far ends of a surface equally near.
constexpr float kFarOff = 16.0F;

/// The distance of a pixel from the line between its two neighbours, times its area.
float off_line(const Surface& surface, std::int32_t pixel, std::int32_t step) {
  const Vec3 from = surface.sample(pixel - step).point();
  const Vec3 along = surface.sample(pixel + step).point() - from;
  const float length = along.squaredNorm();
  if (!(length > 0.0F)) return 0.0F;
  const Sample& sample = surface.sample(pixel);
  return sample.weight * std::sqrt((sample.point() - from).cross(along).squaredNorm() / length);
}

}  // namespace

void ContourBlocks::assign(const Surface& surface) {
  across_ = (surface.cols() - 1) / kSize;
  down_ = (surface.rows() - 1) / kSize;
  make_room(states_, std::int64_t{across_} * down_);
  states_.assign(static_cast<std::size_t>(across_) * down_, State::kEmpty);
  constexpr std::uint32_t kAllFull = 0x01010101U * kFull;  // a row of cells of a square
  static_assert(kSize == sizeof kAllFull);
  for (int row = 0; row < down_; ++row) {
    for (int column = 0; column < across_; ++column) {
      std::uint32_t all = kAllFull, any = 0;
      for (int v = row * kSize; v < (row + 1) * kSize; ++v) {
        std::uint32_t cells = 0;
        std::memcpy(&cells, &surface.cells()[std::ptrdiff_t{v} * surface.cols() + column * kSize],
                    sizeof cells);
        all &= cells;
        any |= cells;
      }
      if ((any & kAllFull) == 0) continue;
      states_[row * across_ + column] = all == kAllFull ? State::kWhole : State::kCut;
    }
  }
  before_ = states_;
  for (int row = 0; row < down_; ++row) {
    for (int column = 0; column < across_; ++column) {
      if (before_[row * across_ + column] == State::kCut) cut_beside(surface, column, row);
    }
  }
}

/// Sets whole squares beside a cut one to kCut if they get vertices on the common side.
void ContourBlocks::cut_beside(const Surface& surface, int column, int row) {
  const auto look = [&](int i, int j, int u, int v, bool upright) {
    if (i < 0 || j < 0 || i >= across_ || j >= down_ || before_[j * across_ + i] != State::kWhole) {
      return;
    }
    for (int k = 1; k < kSize; ++k) {
      const CellsAround cells(surface, upright ? u : u + k, upright ? v + k : v);
      if (!turns_at_line(cells, upright)) continue;
      states_[j * across_ + i] = State::kCut;
      return;
    }
  };
  const int u = column * kSize, v = row * kSize;
  look(column - 1, row, u, v, true);
  look(column + 1, row, u + kSize, v, true);
  look(column, row - 1, u, v, false);
  look(column, row + 1, u, v + kSize, false);
}

ContourBlocks::State ContourBlocks::around(int u, int v) const {
  const int column = u / kSize, row = v / kSize;
  const int first_column = std::max(column - 1, 0), last_column = std::min(column, across_ - 1);
  const State first = state_of(first_column, std::max(row - 1, 0));
  for (int j = std::max(row - 1, 0); j <= std::min(row, down_ - 1); ++j) {
    for (int i = first_column; i <= last_column; ++i) {
      if (state_of(i, j) != first) return State::kCut;
    }
  }
  return first;
}

void ContourBlocks::fill(int cols, float whole, float other, std::vector<float>& out) const {
  for (int v = 0; v <= down_ * kSize; ++v) {
    const int row = v / kSize;
    float* const to = out.data() + std::ptrdiff_t{v} * cols;
    bool is_before = false;
    for (int column = 0; column <= across_; ++column) {
      const bool is_here = state_of(column, row) == State::kWhole ||
                           (v % kSize == 0 && state_of(column, row - 1) == State::kWhole);
      to[column * kSize] = is_here || is_before ? whole : other;
      if (column < across_)
        std::fill_n(to + column * kSize + 1, kSize - 1, is_here ? whole : other);
      is_before = is_here;
    }
  }
}

void ContourBlocks::emit(const Surface& surface, std::span<const float> errors, float threshold,
                         std::span<const Keep> keep, std::vector<Triangle>& out) {
  const Marks marks{errors, threshold, keep};
  for (int row = 0; row < down_; ++row) {
    for (int column = 0; column < across_; ++column) {
      if (states_[row * across_ + column] != State::kCut) continue;
      u0_ = column * kSize, v0_ = row * kSize;
      find_edges(surface);
      places_.clear();
      loops_.clear();
      for (int p = 0; p < kStride * kStride; ++p) {
        while (edges_[p] != 0) trace(surface, marks, p);
      }
      join_holes();
      triangles_.clear();
      for (const Loop& loop : loops_) clip_ears(loop);
      insert_kept(surface, keep);
      refine(surface, threshold);
      for (const auto& [a, b, c] : triangles_) {
        out.push_back({pixel_of(surface, a), pixel_of(surface, b), pixel_of(surface, c)});
      }
    }
  }
}

/// Adds the edge of a triangle that is on its left; cancels it with that of a triangle on its
/// right.
void ContourBlocks::add_edge(int from, int direction) {
  const int to = from + kUp[direction] * kStride + kAcross[direction];
  const auto back = static_cast<std::uint8_t>(1U << ((direction + 4) & 7));
  if ((edges_[to] & back) != 0) {
    edges_[to] &= static_cast<std::uint8_t>(~back);
  } else {
    edges_[from] |= static_cast<std::uint8_t>(1U << direction);
  }
}

void ContourBlocks::find_edges(const Surface& surface) {
  edges_.fill(0);
  for (int v = 0; v < kSize; ++v) {
    for (int u = 0; u < kSize; ++u) {
      const std::uint8_t cell = surface.cell((v0_ + v) * surface.cols() + u0_ + u);
      if ((cell & kFull) == 0) continue;
      const int a = v * kStride + u, b = a + 1, c = a + kStride, d = c + 1;
      const bool has_first = (cell & kFirst) != 0, has_second = (cell & kSecond) != 0;
      const bool turned = (cell & kCutFromBToC) != 0;
      if (has_first) add_edge(a, kRight);
      if (has_second) add_edge(d, kLeft);
      if (turned ? has_second : has_first) add_edge(b, kTop);
      if (turned ? has_first : has_second) add_edge(c, kDown);
      if (has_first && has_second) continue;
      if (turned) {
        has_first ? add_edge(b, kLeftUp) : add_edge(c, kRightDown);
      } else {
        has_first ? add_edge(d, kLeftDown) : add_edge(a, kRightUp);
      }
    }
  }
}

bool ContourBlocks::is_vertex(const Surface& surface, const Marks& marks, const Place& p,
                              int direction) const {
  const std::int32_t pixel = pixel_of(surface, p);
  if (!marks.keep.empty() && marks.keep[pixel] != Keep::kFree) return true;
  if (p.is_on_side()) {
    if (p.is_corner() || marks.errors[pixel] >= marks.threshold) return true;
    const bool upright = p.u == 0 || p.u == kSize;
    if (turns_at_line(CellsAround(surface, u0_ + p.u, v0_ + p.v), upright)) return true;
    direction = upright ? kTop : kRight;
  }
  const std::int32_t step = kUp[direction] * surface.cols() + kAcross[direction];
  return off_line(surface, pixel, step) >= kFarOff * marks.threshold;
}

/// Removes a loop of edges, which has the surface on its left, and appends the pixels at which it
/// turns or has a vertex. At a pixel where several fans of triangles meet, it stays with its own
/// fan.
void ContourBlocks::trace(const Surface& surface, const Marks& marks, int start) {
  const auto first = static_cast<std::int32_t>(places_.size());
  const int first_direction = std::countr_zero(edges_[start]);
  int p = start, direction = first_direction;
  do {
    edges_[p] &= static_cast<std::uint8_t>(~(1U << direction));
    p += kUp[direction] * kStride + kAcross[direction];
    // Clockwise from the direction from which it came.
    const unsigned mask = edges_[p] | (p == start ? 1U << first_direction : 0U);
    int next = direction + 3;
    while ((mask >> (next & 7) & 1U) == 0) --next;
    next &= 7;
    const Place place{p % kStride, p / kStride};
    if (next != direction || is_vertex(surface, marks, place, direction)) places_.push_back(place);
    direction = next;
  } while (p != start || direction != first_direction);
  loops_.push_back({first, static_cast<std::int32_t>(places_.size())});
}

/// Joins loops around holes to the loop that encloses them.
void ContourBlocks::join_holes() {
  for (std::size_t n = 0; n < loops_.size();) {
    const Loop loop = loops_[n];
    std::int32_t area = 0;
    for (std::int32_t i = loop.first + 1; i + 1 < loop.last; ++i) {
      area += doubled_area(places_[loop.first], places_[i], places_[i + 1]);
    }
    if (area > 0) {
      ++n;
      continue;
    }
    join(loop);
    loops_.erase(loops_.begin() + static_cast<std::ptrdiff_t>(n));
    n = 0;
  }
}

/// Makes one loop of two: to the hole from the nearest corner that sees one of its corners, around
/// the hole and back.
void ContourBlocks::join(const Loop& hole) {
  std::int32_t least = std::numeric_limits<std::int32_t>::max();
  std::int32_t from = 0, to = 0;
  Loop* around = nullptr;
  for (Loop& loop : loops_) {
    if (loop.first == hole.first) continue;
    for (std::int32_t i = loop.first; i < loop.last; ++i) {
      for (std::int32_t k = hole.first; k < hole.last; ++k) {
        const std::int32_t du = places_[i].u - places_[k].u, dv = places_[i].v - places_[k].v;
        const std::int32_t distance = du * du + dv * dv;
        if (distance >= least || !is_seen(places_[k], places_[i])) continue;
        least = distance, from = i, to = k;
        around = &loop;
      }
    }
  }
  if (around == nullptr) return;  // no loop encloses it: the hole is outside
  polygon_.assign(places_.begin() + around->first, places_.begin() + from + 1);
  polygon_.insert(polygon_.end(), places_.begin() + to, places_.begin() + hole.last);
  polygon_.insert(polygon_.end(), places_.begin() + hole.first, places_.begin() + to + 1);
  polygon_.insert(polygon_.end(), places_.begin() + from, places_.begin() + around->last);
  around->first = static_cast<std::int32_t>(places_.size());
  places_.insert(places_.end(), polygon_.begin(), polygon_.end());
  around->last = static_cast<std::int32_t>(places_.size());
}

/// Whether the line between two pixels meets edges only at its own ends.
bool ContourBlocks::is_seen(const Place& from, const Place& to) const {
  const auto sign = [](std::int32_t value) { return (value > 0 ? 1 : 0) - (value < 0 ? 1 : 0); };
  const auto is_same = [](const Place& p, const Place& q) { return p.u == q.u && p.v == q.v; };
  const auto is_on = [](const Place& p, const Place& a, const Place& b) {
    return doubled_area(a, b, p) == 0 && p.u >= std::min(a.u, b.u) && p.u <= std::max(a.u, b.u) &&
           p.v >= std::min(a.v, b.v) && p.v <= std::max(a.v, b.v);
  };
  if (is_same(from, to)) return false;
  for (const Loop& loop : loops_) {
    for (std::int32_t i = loop.first; i < loop.last; ++i) {
      const Place &a = places_[i], &b = places_[i + 1 < loop.last ? i + 1 : loop.first];
      if (!is_same(a, from) && !is_same(a, to) && is_on(a, from, to)) return false;
      if (!is_same(from, a) && !is_same(from, b) && is_on(from, a, b)) return false;
      if (!is_same(to, a) && !is_same(to, b) && is_on(to, a, b)) return false;
      if (sign(doubled_area(from, to, a)) * sign(doubled_area(from, to, b)) < 0 &&
          sign(doubled_area(a, b, from)) * sign(doubled_area(a, b, to)) < 0) {
        return false;
      }
    }
  }
  return true;
}

/// The pixels in and on a triangle, except its corners, as bits.
std::uint32_t ContourBlocks::pixels_in(const Place& a, const Place& b, const Place& c) {
  const auto number = [](const Place& p) { return static_cast<std::size_t>(p.v * kStride + p.u); };
  const std::size_t i = number(a), j = number(b), k = number(c);
  return kLeftOf[i][j] & kLeftOf[j][k] & kLeftOf[k][i] & ~(1U << i | 1U << j | 1U << k);
}

/// Triangulates a loop by repeatedly cutting off the corner whose new side is the shortest.
void ContourBlocks::clip_ears(const Loop& loop) {
  polygon_.assign(places_.begin() + loop.first, places_.begin() + loop.last);
  while (polygon_.size() >= 3) {
    const auto size = static_cast<std::int32_t>(polygon_.size());
    const auto at = [&](std::int32_t i) -> const Place& {
      return polygon_[i < 0 ? i + size : i < size ? i : i - size];
    };
    std::uint32_t corners = 0;
    for (const Place& p : polygon_) corners |= bit_at(p.u, p.v);
    std::int32_t least = std::numeric_limits<std::int32_t>::max(), best = -1;
    for (std::int32_t i = 0; i < size; ++i) {
      const Place &a = at(i - 1), &b = at(i), &c = at(i + 1);
      const std::int32_t length = (c.u - a.u) * (c.u - a.u) + (c.v - a.v) * (c.v - a.v);
      if (length >= least || doubled_area(a, b, c) <= 0) continue;
      if ((pixels_in(a, b, c) & corners) == 0) least = length, best = i;
    }
    if (best < 0) return;  // only a line is left
    triangles_.push_back({at(best - 1), at(best), at(best + 1)});
    polygon_.erase(polygon_.begin() + best);
  }
}

void ContourBlocks::insert_kept(const Surface& surface, std::span<const Keep> keep) {
  if (keep.empty()) return;
  for (int v = 1; v < kSize; ++v) {
    for (int u = 1; u < kSize; ++u) {
      const Place place{u, v};
      if (keep[pixel_of(surface, place)] == Keep::kFree) continue;
      if (CellsAround(surface, u0_ + u, v0_ + v).are_complete()) insert(place);
    }
  }
}

void ContourBlocks::refine(const Surface& surface, float threshold) {
  if (!(threshold < std::numeric_limits<float>::infinity())) return;
  for (;;) {
    float most = threshold;
    Place farthest;
    bool found = false;
    for (const PlaceTriangle& corners : triangles_) {
      found = find_farthest(surface, corners, most, farthest) || found;
    }
    if (!found) return;
    insert(farthest);
  }
}

bool ContourBlocks::find_farthest(const Surface& surface, const PlaceTriangle& corners, float& most,
                                  Place& farthest) const {
  const auto& [a, b, c] = corners;
  std::uint32_t pixels = pixels_in(a, b, c) & kInner;
  if (pixels == 0) return false;
  const Vec3 origin = surface.sample(pixel_of(surface, a)).point();
  const Vec3 normal = (surface.sample(pixel_of(surface, b)).point() - origin)
                          .cross(surface.sample(pixel_of(surface, c)).point() - origin);
  bool found = false;
  for (; pixels != 0; pixels &= pixels - 1) {
    const int number = std::countr_zero(pixels);
    const Place p{number % kStride, number / kStride};
    const std::int32_t pixel = pixel_of(surface, p);
    const float off = std::abs(normal.dot(surface.sample(pixel).point() - origin));
    const float error = off * surface.confidence(pixel);
    if (!(error > most) || !CellsAround(surface, u0_ + p.u, v0_ + p.v).are_complete()) continue;
    most = error;
    farthest = p;
    found = true;
  }
  return found;
}

/// Inserts a pixel into the triangle that contains it, or into the two triangles at its edge.
void ContourBlocks::insert(const Place& place) {
  const std::size_t size = triangles_.size();
  std::size_t kept = 0;
  for (std::size_t i = 0; i < size; ++i) {
    const PlaceTriangle t = triangles_[i];
    std::array<std::int32_t, 3> areas{};
    for (std::size_t k = 0; k < 3; ++k) areas[k] = doubled_area(t[k], t[(k + 1) % 3], place);
    if (std::ranges::any_of(areas, [](std::int32_t area) { return area < 0; })) {
      triangles_[kept++] = t;
      continue;
    }
    for (std::size_t k = 0; k < 3; ++k) {
      if (areas[k] > 0) triangles_.push_back({t[k], t[(k + 1) % 3], place});
    }
  }
  triangles_.erase(triangles_.begin() + static_cast<std::ptrdiff_t>(kept),
                   triangles_.begin() + static_cast<std::ptrdiff_t>(size));
}

}  // namespace manip3d::relief_detail

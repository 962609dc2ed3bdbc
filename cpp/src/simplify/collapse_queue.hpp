#pragma once

#include <cstdint>
#include <tuple>
#include <vector>

namespace manip3d {

/// The best collapse of a vertex: onto `target`, at `cost`.
struct Candidate {
  double cost = 0.0;
  double squared_length = 0.0;
  std::int32_t vertex = -1;
  std::int32_t target = -1;

  /// Cheaper first, then the shorter edge, then the lower indices: a total order.
  friend bool operator<(const Candidate& a, const Candidate& b) {
    if (a.cost != b.cost) return a.cost < b.cost;
    if (a.squared_length != b.squared_length) return a.squared_length < b.squared_length;
    return std::tie(a.vertex, a.target) < std::tie(b.vertex, b.target);
  }
};

/// Priority queue of at most one candidate per vertex: an indexed 4-ary heap in one array, so that
/// the children of a node share cache lines.
class CollapseQueue {
 public:
  explicit CollapseQueue(std::size_t num_vertices) : position_(num_vertices, -1) {}

  [[nodiscard]] bool empty() const { return heap_.empty(); }
  [[nodiscard]] const Candidate& top() const { return heap_.front(); }

  /// Inserts the candidate of its vertex, or replaces it.
  void set(const Candidate& candidate) {
    std::int32_t& position = position_[candidate.vertex];
    if (position < 0) {
      position = static_cast<std::int32_t>(heap_.size());
      heap_.push_back(candidate);
      sift_up(position);
      return;
    }
    const bool cheaper = candidate < at(position);
    at(position) = candidate;
    cheaper ? sift_up(position) : sift_down(position);
  }

  void remove(std::int32_t vertex) {
    const std::int32_t position = position_[vertex];
    if (position < 0) return;
    position_[vertex] = -1;
    const Candidate last = heap_.back();
    heap_.pop_back();
    if (position == static_cast<std::int32_t>(heap_.size())) return;
    const bool cheaper = last < at(position);
    put(position, last);
    cheaper ? sift_up(position) : sift_down(position);
  }

 private:
  Candidate& at(std::int32_t i) { return heap_[i]; }

  void put(std::int32_t i, const Candidate& candidate) {
    at(i) = candidate;
    position_[candidate.vertex] = i;
  }

  void sift_up(std::int32_t i) {
    const Candidate moving = at(i);
    while (i > 0) {
      const std::int32_t parent = (i - 1) / 4;
      if (!(moving < at(parent))) break;
      put(i, at(parent));
      i = parent;
    }
    put(i, moving);
  }

  void sift_down(std::int32_t i) {
    const Candidate moving = at(i);
    const auto size = static_cast<std::int32_t>(heap_.size());
    for (;;) {
      const std::int32_t first = 4 * i + 1;
      if (first >= size) break;
      const std::int32_t last = first + 4 < size ? first + 4 : size;
      std::int32_t child = first;
      for (std::int32_t k = first + 1; k < last; ++k) {
        if (at(k) < at(child)) child = k;
      }
      if (!(at(child) < moving)) break;
      put(i, at(child));
      i = child;
    }
    put(i, moving);
  }

  std::vector<Candidate> heap_;
  std::vector<std::int32_t> position_;  // of a vertex in heap_; -1: not queued
};

}  // namespace manip3d

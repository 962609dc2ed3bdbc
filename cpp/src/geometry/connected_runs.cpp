#include "manip3d/geometry/connected_runs.hpp"

#include <algorithm>

#include "geometry/union_find.hpp"

namespace manip3d {

struct ConnectedRuns::Memory {
  std::vector<std::int32_t> row_start;  // first run of each row
  std::vector<std::int32_t> number;     // number of the component, by root
  UnionFind sets;
};

ConnectedRuns::ConnectedRuns() : memory_(std::make_unique<Memory>()) {}
ConnectedRuns::ConnectedRuns(ConnectedRuns&&) noexcept = default;
ConnectedRuns& ConnectedRuns::operator=(ConnectedRuns&&) noexcept = default;
ConnectedRuns::~ConnectedRuns() = default;

void ConnectedRuns::reserve(std::int64_t rows, std::int64_t columns) {
  const std::size_t most = rows * ((columns + 1) / 2);
  runs_.reserve(most);
  memory_->row_start.reserve(static_cast<std::size_t>(rows) + 1);
  memory_->number.reserve(most);
  memory_->sets.reset(static_cast<std::int32_t>(most));
}

// Joins the runs of a row with those of the previous row and, in a panorama, across its ends.
void ConnectedRuns::join_rows(std::int64_t row, std::int64_t columns, bool goes_round) {
  UnionFind& sets = memory_->sets;
  const std::int32_t begin = memory_->row_start[row], end = memory_->row_start[row + 1];
  const std::int32_t above = row > 0 ? memory_->row_start[row - 1] : begin;
  if (begin == end) return;
  std::int32_t first = above;  // first run of the previous row that may still touch
  for (std::int32_t i = begin; i < end; ++i) {
    while (first < begin && runs_[first].last + 1 < runs_[i].first) ++first;
    for (std::int32_t j = first; j < begin && runs_[j].first <= runs_[i].last + 1; ++j) {
      sets.join(i, j);
    }
  }
  if (!goes_round) return;
  const auto meet = [&](std::int32_t left, std::int32_t right) {
    if (runs_[left].first == 0 && runs_[right].last == columns - 1) sets.join(left, right);
  };
  meet(begin, end - 1);
  if (above == begin) return;
  meet(begin, begin - 1);
  meet(above, end - 1);
}

const std::vector<MarkedRun>& ConnectedRuns::find(const std::uint8_t* cells, std::int64_t rows,
                                                  std::int64_t columns, bool goes_round) {
  auto& [row_start, number, sets] = *memory_;
  runs_.clear();
  row_start.assign(1, 0);
  for (std::int64_t r = 0; r < rows; ++r, cells += columns) {
    const std::uint8_t* const end = cells + columns;
    for (const std::uint8_t* c = std::find(cells, end, 1); c != end; c = std::find(c, end, 1)) {
      const std::uint8_t* last = std::find(c, end, 0);
      runs_.push_back({r, c - cells, last - cells - 1});
      c = last;
    }
    row_start.push_back(static_cast<std::int32_t>(runs_.size()));
  }
  sets.reset(row_start.back());
  for (std::int64_t r = 0; r < rows; ++r) join_rows(r, columns, goes_round);
  number.assign(runs_.size(), -1);
  num_components_ = 0;
  for (std::int32_t i = 0; i < row_start.back(); ++i) {
    std::int32_t& mine = number[sets.root(i)];
    if (mine < 0) mine = num_components_++;
    runs_[i].component = mine;
  }
  return runs_;
}

}  // namespace manip3d

#pragma once

#include <cstdint>
#include <memory>
#include <vector>

namespace manip3d {

/// Marked cells side by side in a row of a binary image, as many as there are.
struct MarkedRun {
  std::int64_t row, first, last;  ///< Columns, both inside.
  std::int32_t component = 0;
};

/// Finds what is connected in binary images, corners included. Keeps its memory.
class ConnectedRuns {
 public:
  ConnectedRuns();
  ConnectedRuns(ConnectedRuns&&) noexcept;
  ConnectedRuns& operator=(ConnectedRuns&&) noexcept;
  ~ConnectedRuns();

  /// The runs in the order of rows and columns; components are numbered by their first runs.
  /// @param cells       (rows, columns), 0 or 1 = marked.
  /// @param goes_round  Column 0 is the neighbour of the last one.
  const std::vector<MarkedRun>& find(const std::uint8_t* cells, std::int64_t rows,
                                     std::int64_t columns, bool goes_round);
  /// Makes room for images of so many cells.
  void reserve(std::int64_t rows, std::int64_t columns);
  [[nodiscard]] std::int32_t num_components() const { return num_components_; }

 private:
  struct Memory;
  void join_rows(std::int64_t row, std::int64_t columns, bool goes_round);

  std::vector<MarkedRun> runs_;
  std::int32_t num_components_ = 0;
  std::unique_ptr<Memory> memory_;
};

}  // namespace manip3d

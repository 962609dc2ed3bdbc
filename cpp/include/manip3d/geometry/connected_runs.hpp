#pragma once

#include <cstdint>
#include <memory>
#include <vector>

namespace manip3d {

/// A maximal run of adjacent marked cells in a row of a binary image.
struct MarkedRun {
  std::int64_t row;
  std::int64_t first, last;    ///< Columns of the first and the last cell.
  std::int32_t component = 0;  ///< Number of the connected component, from 0.
};

/// Finds the connected components of binary images; cells that touch at a corner are connected (8
/// neighbours). Keeps its memory from image to image.
class ConnectedRuns {
 public:
  ConnectedRuns();
  ConnectedRuns(ConnectedRuns&&) noexcept;
  ConnectedRuns& operator=(ConnectedRuns&&) noexcept;
  ~ConnectedRuns();

  /// The runs of an image in the order of rows, then columns, valid until the next call. Components
  /// are numbered in the order of their first runs.
  /// @param cells       (rows, columns), 1 where marked, else 0; other values are not allowed.
  /// @param goes_round  Whether column 0 is the neighbour of the last one, as in a panorama. A
  ///                    run still ends at the last column.
  const std::vector<MarkedRun>& find(const std::uint8_t* cells, std::int64_t rows,
                                     std::int64_t columns, bool goes_round);
  /// Makes room for images of this size, so that find() allocates nothing.
  void reserve(std::int64_t rows, std::int64_t columns);
  /// The number of components in the image of the last find().
  [[nodiscard]] std::int32_t num_components() const { return num_components_; }

 private:
  struct Memory;
  void join_rows(std::int64_t row, std::int64_t columns, bool goes_round);

  std::vector<MarkedRun> runs_;
  std::int32_t num_components_ = 0;
  std::unique_ptr<Memory> memory_;
};

}  // namespace manip3d

#include "manip3d/geometry/weld.hpp"

#include <algorithm>
#include <array>
#include <tuple>

namespace manip3d {
namespace {

template <std::size_t Columns>
struct Row {
  std::array<double, Columns> values;
  std::int32_t index;
  bool operator<(const Row& other) const {
    return std::tie(values, index) < std::tie(other.values, other.index);
  }
};

}  // namespace

template <int Columns>
Weld weld_rows(const Eigen::Ref<const Rows<double, Columns>>& table, const Progress& progress) {
  constexpr auto kColumns = static_cast<std::size_t>(Columns);
  const std::size_t num_rows = table.rows();
  std::vector<Row<kColumns>> rows(num_rows);
  for (std::size_t i = 0; i < num_rows; ++i) {
    for (std::size_t c = 0; c < kColumns; ++c) {
      rows[i].values[c] = table(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(c));
    }
    rows[i].index = static_cast<std::int32_t>(i);
  }
  Ticker ticker(progress, 1U << 16);
  std::sort(rows.begin(), rows.end(), [&](const auto& a, const auto& b) {
    ticker.tick();
    return a < b;  // no ties, because the index is compared as well
  });

  Weld result;
  Indices first_with_value(table.rows());
  for (std::size_t i = 0; i < num_rows; ++i) {
    const bool repeats = i > 0 && rows[i].values == rows[i - 1].values;
    first_with_value[rows[i].index] = repeats ? first_with_value[rows[i - 1].index] : rows[i].index;
  }
  result.value.resize(table.rows());
  result.first_row.resize(table.rows());
  std::int32_t num_values = 0;
  for (std::int32_t i = 0; i < table.rows(); ++i) {
    const std::int32_t first = first_with_value[i];
    if (first == i) result.first_row[num_values] = i;
    result.value[i] = first == i ? num_values++ : result.value[first];
  }
  result.first_row.conservativeResize(num_values);
  return result;
}

template Weld weld_rows<2>(const Eigen::Ref<const Rows<double, 2>>&, const Progress&);
template Weld weld_rows<3>(const Eigen::Ref<const Rows<double, 3>>&, const Progress&);

Faces weld_indices(const Eigen::Ref<const Faces>& indices, const Weld& weld) {
  return indices.unaryExpr(
      [&](std::int32_t row) { return row < 0 ? std::int32_t{-1} : weld.value[row]; });
}

}  // namespace manip3d

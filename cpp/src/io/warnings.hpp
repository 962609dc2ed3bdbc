#pragma once

#include <string>
#include <utility>
#include <vector>

namespace manip3d {

/// Keeps the first hundred: a hostile file may give cause for a million.
inline void warn(std::vector<std::string>& warnings, std::string text) {
  constexpr std::size_t kMost = 100;
  if (warnings.size() < kMost) warnings.push_back(std::move(text));
}

}  // namespace manip3d

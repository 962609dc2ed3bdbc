#pragma once

#include <algorithm>
#include <string>
#include <utility>
#include <vector>

namespace manip3d {

/// Tells each text once, and keeps the first hundred: a hostile file may give cause for a million.
inline void warn(std::vector<std::string>& warnings, std::string text) {
  constexpr std::size_t kMost = 100;
  if (warnings.size() == kMost) return;
  if (std::find(warnings.begin(), warnings.end(), text) != warnings.end()) return;
  warnings.push_back(std::move(text));
}

}  // namespace manip3d

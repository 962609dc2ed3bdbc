#pragma once

#include <algorithm>
#include <string>
#include <utility>
#include <vector>

namespace manip3d {

/// Adds a warning unless it is there already. Only the first hundred are kept, because a malicious
/// file may cause a million.
inline void warn(std::vector<std::string>& warnings, std::string text) {
  constexpr std::size_t kMost = 100;
  if (warnings.size() == kMost) return;
  if (std::find(warnings.begin(), warnings.end(), text) != warnings.end()) return;
  warnings.push_back(std::move(text));
}

}  // namespace manip3d

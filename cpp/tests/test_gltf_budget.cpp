// The budget of a glTF file near the limits of 64 bits.
#include <gtest/gtest.h>

#include <cstdint>
#include <limits>

#include "io/gltf.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

constexpr std::int64_t kMost = std::numeric_limits<std::int64_t>::max();
constexpr std::int64_t kGibibyte = std::int64_t{1} << 30;

TEST(GltfBudget, TheDefaultIsByTheStoredBytes) {
  GltfBudget budget(1);
  EXPECT_THROW(budget.charge(kGibibyte, "mesh"), FormatError);
}

TEST(GltfBudget, UnsignedLimitsBeyondSignedOnesAllowAll) {
  for (const std::uint64_t limit :
       {std::uint64_t{1} << 63, std::numeric_limits<std::uint64_t>::max()}) {
    GltfBudget budget(1, limit);
    EXPECT_NO_THROW(budget.charge(kGibibyte, "mesh"));
  }
}

TEST(GltfBudget, ChargesThatDoNotFit64BitsTogetherAreTooMuch) {
  GltfBudget budget(1, static_cast<std::uint64_t>(kMost));
  budget.charge(kMost / 2 + 1, "mesh");
  EXPECT_THROW(budget.charge(kMost / 2 + 1, "mesh"), FormatError);
  EXPECT_NO_THROW(budget.charge(kMost / 2, "mesh"));
}

}  // namespace
}  // namespace manip3d

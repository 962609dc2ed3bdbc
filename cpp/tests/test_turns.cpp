#include <gtest/gtest.h>

#include <limits>
#include <string>

#include "manip3d/authenticate/turns.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kInfinity = std::numeric_limits<double>::infinity();

ScanLattice two_rings() {
  ScanLattice lattice;
  lattice.rings.resize(2);
  lattice.rings[0].slope = 0.1;
  lattice.rings[1].slope = -0.1;
  return lattice;
}

std::string error_of(const ScanLattice& lattice, const TurnOptions& options) {
  const Points none(0, 3);
  const PointsView view({none.data(), none.rows(), 3});
  try {
    static_cast<void>(compare_turns(view, view, view, lattice, options));
  } catch (const InputError& error) {
    return error.what();
  }
  return {};
}

TEST(Turns, NumbersThatAreNotFiniteAreRefused) {
  EXPECT_EQ(error_of(two_rings(), {}), "");
  TurnOptions options;
  options.height = kNan;
  EXPECT_EQ(error_of(two_rings(), options), "height: expected a number that is finite, got nan");
  options = {};
  options.tolerance = kInfinity;
  EXPECT_EQ(error_of(two_rings(), options),
            "tolerance: expected a number > 0 that is finite, got inf");
  options = {};
  options.tolerance_share = kInfinity;
  EXPECT_EQ(error_of(two_rings(), options),
            "tolerance_share: expected a number >= 0 that is finite, got inf");
}

TEST(Turns, ALatticeWithoutRingsIsRefusedAlsoWithoutAGround) {
  EXPECT_NE(error_of(ScanLattice{}, {}), "");
}

}  // namespace
}  // namespace manip3d

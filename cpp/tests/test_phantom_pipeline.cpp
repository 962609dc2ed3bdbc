#include <gtest/gtest.h>

#include <array>
#include <cstddef>
#include <cstdint>
#include <new>
#include <vector>

#include "allocations.hpp"
#include "body_of_disks.hpp"
#include "manip3d/error.hpp"
#include "manip3d/modify/phantom_pipeline.hpp"

namespace manip3d {
namespace {

using testing::kCountsAllocations;
using testing::num_allocations;

struct Images {
  std::vector<float> depth, vertices, texcoords;
  std::vector<std::uint8_t> label;
  std::vector<PixelKind> kind;
  std::vector<std::int32_t> source, pixels, faces;

  explicit Images(std::size_t size)
      : depth(size),
        vertices(3 * size),
        texcoords(2 * size),
        label(size),
        kind(size),
        source(2 * size),
        pixels(2 * size),
        faces(6 * size) {}
  PhantomBuffers buffers() {
    return {depth.data(),
            label.data(),
            kind.data(),
            source.data(),
            {static_cast<std::int64_t>(depth.size()), vertices.data(), pixels.data(),
             texcoords.data(), faces.data()}};
  }
};

/// A person who sways. The intact arm is hidden for some frames, and for some frames nobody is
/// there.
class Recording {
 public:
  Recording() : camera_(testing::small_kinect()) {
    registration_.color = {640, 480, 525.0, 525.0, 320.0, 240.0, {}, nullptr, false};
    for (int i = 0; i < kFrames; ++i) {
      people_.push_back(testing::standing_person(0.01F * static_cast<float>(i % 9)));
      people_.back().states[6] = people_.back().states[14] =
          i / 20 % 2 == 1 ? TrackingState::kInferred : TrackingState::kTracked;
      depth_.emplace_back();
      body_index_.emplace_back();
      testing::draw_disks(people_.back(), camera_, depth_.back(), body_index_.back());
    }
  }

  [[nodiscard]] std::size_t size() const { return people_.size(); }
  [[nodiscard]] const Intrinsics& camera() const { return camera_; }
  [[nodiscard]] PhantomInput frame(std::size_t i) const {
    PhantomInput input;
    input.depth = {camera_.height, camera_.width, depth_[i].data(), nullptr};
    input.body_index = body_index_[i].data();
    input.camera = camera_;
    input.registration = &registration_;
    const bool nobody = i > 70 && i < 75;
    input.people = std::span(&people_[i], nobody ? 0U : 1U);
    input.number = static_cast<std::int64_t>(i);
    input.time_ns = 33'333'333 * input.number;
    return input;
  }

 private:
  static constexpr int kFrames = 90;
  Intrinsics camera_;
  Registration registration_;
  std::vector<Skeleton> people_;
  std::vector<std::vector<std::uint16_t>> depth_;
  std::vector<std::vector<std::uint8_t>> body_index_;
};

// The report without a person is constructed in memory with arbitrary contents.
TEST(PhantomReport, HoldsNoUninitializedJoint) {
  alignas(PhantomReport) std::array<std::byte, sizeof(PhantomReport)> memory;
  memory.fill(std::byte{0x5a});
  const auto* report = new (memory.data()) PhantomReport;
  for (const Eigen::Vector3f& place : report->skeleton.positions) {
    EXPECT_TRUE(place == Eigen::Vector3f::Zero());
  }
  report->~PhantomReport();
}

TEST(PhantomPipeline, AllocatesNothingAfterTheTenthFrame) {
  if (!kCountsAllocations) GTEST_SKIP() << "sanitizers allocate in their own way";
  const Recording recording;
  Images out(static_cast<std::size_t>(recording.camera().width * recording.camera().height));
  for (const Limb limb : {Limb::kLeftArm, Limb::kRightArm, Limb::kLeftLeg, Limb::kRightLeg}) {
    PhantomOptions options;
    options.affected = limb;
    options.segmentation = is_arm(limb) ? BoneRule::kSkin : BoneRule::kPaper;
    PhantomPipeline pipeline(options);
    std::array<int, 5> states{};
    for (std::size_t i = 0; i < recording.size(); ++i) {
      const PhantomInput input = recording.frame(i);
      const PhantomBuffers buffers = out.buffers();
      const std::int64_t before = num_allocations();
      const PhantomReport report = pipeline.process(input, buffers);
      if (i >= 10) {
        EXPECT_EQ(num_allocations(), before) << "frame " << i;
      }
      ++states[static_cast<std::size_t>(report.state)];
      EXPECT_GT(report.mesh.num_faces, 3000);
    }
    EXPECT_GT(states[static_cast<std::size_t>(PhantomState::kTracking)], 30);
    EXPECT_GT(states[static_cast<std::size_t>(PhantomState::kHolding)], 3);
  }
}

TEST(PhantomPipeline, RefusesWhatDoesNotFitAndGoesOn) {
  const Recording recording;
  Images out(static_cast<std::size_t>(recording.camera().width * recording.camera().height));
  PhantomPipeline pipeline;
  EXPECT_EQ(pipeline.process(recording.frame(0), out.buffers()).state, PhantomState::kTracking);
  PhantomInput empty = recording.frame(1);
  empty.depth.rows = empty.depth.cols = 0;
  EXPECT_THROW(pipeline.process(empty, out.buffers()), InputError);
  empty.camera.width = empty.camera.height = 0;
  EXPECT_THROW(pipeline.process(empty, out.buffers()), InputError);
  PhantomInput wrong = recording.frame(1);
  wrong.camera.fx = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(pipeline.process(wrong, out.buffers()), InputError);
  PhantomInput unmeasured = recording.frame(1);
  unmeasured.depth.millimetres = nullptr;
  try {
    pipeline.process(unmeasured, out.buffers());
    ADD_FAILURE() << "a depth image without numbers";
  } catch (const InputError& error) {
    EXPECT_STREQ(error.what(), "depth: expected either millimetres or metres");
  }
  PhantomBuffers small = out.buffers();
  small.mesh.capacity = 100;
  EXPECT_THROW(pipeline.process(recording.frame(1), small), InputError);
  EXPECT_EQ(pipeline.process(recording.frame(2), out.buffers()).state, PhantomState::kTracking);
}

TEST(PhantomPipeline, LeavesSeamsOpenWhereThereIsNoRoom) {
  const Recording recording;
  Images out(static_cast<std::size_t>(recording.camera().width * recording.camera().height));
  const PhantomReport roomy = PhantomPipeline().process(recording.frame(0), out.buffers());
  ASSERT_GT(roomy.mesh.num_vertices, roomy.num_points);
  PhantomBuffers tight = out.buffers();
  tight.mesh.capacity = roomy.num_points;
  const PhantomReport report = PhantomPipeline().process(recording.frame(0), tight);
  EXPECT_EQ(report.mesh.num_vertices, roomy.num_points);
  EXPECT_LT(report.mesh.num_faces, roomy.mesh.num_faces);
}

}  // namespace
}  // namespace manip3d

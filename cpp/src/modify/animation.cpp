#include "manip3d/modify/animation.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include "geometry/cell_cut.hpp"
#include "manip3d/error.hpp"
#include "manip3d/geometry/range_image.hpp"
#include "manip3d/modify/joint_smoother.hpp"
#include "modify/bone_direction.hpp"
#include "modify/torso_frame.hpp"

namespace manip3d {
namespace {

// --- The mesh -----------------------------------------------------------------------------------

/// Whether two bones meet at a joint.
bool meet(std::size_t a, std::size_t b) {
  return a == b || kJointParents[a] == b || kJointParents[b] == a ||
         kJointParents[a] == kJointParents[b];
}

/// Returns the joint between the common neighbour of two bones and the outer bone; 0 if the bones
/// are farther apart.
std::size_t joint_between(std::size_t a, std::size_t b) {
  for (const auto& [outer, inner] : {std::pair(a, b), std::pair(b, a)}) {
    const std::size_t middle = kJointParents[outer];
    if (middle != 0 && meet(middle, inner) && !meet(outer, inner)) return middle;
  }
  return 0;
}

/// Pairs of bones that may share a triangle.
class BonePairs {
 public:
  BonePairs(const Skeleton* skeleton, double reach)
      : squared_reach_(static_cast<float>(reach * reach)) {
    for (std::size_t a = 1; a < kNumJoints; ++a) {
      for (std::size_t b = 1; b < kNumJoints; ++b) {
        joint_[a][b] = kApart;
        if (meet(a, b)) {
          joint_[a][b] = kMeet;
        } else if (skeleton != nullptr && reach > 0.0) {
          const std::size_t joint = joint_between(a, b);
          if (joint != 0 && is_usable(*skeleton, static_cast<Joint>(joint))) {
            joint_[a][b] = static_cast<std::uint8_t>(joint);
          }
        }
      }
    }
    if (skeleton != nullptr) skeleton_ = *skeleton;
  }

  [[nodiscard]] bool fit(std::uint8_t a, std::uint8_t b, const Eigen::Vector3f& p) const {
    const std::uint8_t joint = joint_[a][b];
    if (joint == kMeet) return true;
    return joint != kApart && (p - skeleton_.positions[joint]).squaredNorm() <= squared_reach_;
  }

 private:
  static constexpr std::uint8_t kMeet = 0, kApart = 0xff;
  std::array<std::array<std::uint8_t, kNumJoints>, kNumJoints> joint_{};
  Skeleton skeleton_;
  float squared_reach_;
};

/// The values of a table that was filled row by row.
template <int kColumns, typename Scalar>
Rows<Scalar, kColumns> rows_of(const std::vector<Scalar>& values) {
  return Eigen::Map<const Rows<Scalar, kColumns>>(
      values.data(), static_cast<Eigen::Index>(values.size()) / kColumns, kColumns);
}

/// One vertex for each labelled pixel, in row-major order of the image. Keeps the vertex indices of
/// the last two rows.
class VertexRows {
 public:
  static constexpr std::int32_t kNone = -1;

  VertexRows(const RangeImage& image, const std::uint8_t* labels)
      : image_(image),
        labels_(labels),
        xyz_(static_cast<std::size_t>(3 * image.cols())),
        above_(image.cols()),
        below_(image.cols()) {
    const std::int64_t size = image.rows() * image.cols();
    const std::size_t count = size - std::count(labels, labels + size, 0);
    points_.reserve(3 * count);
    pixels_.reserve(2 * count);
    bones_.reserve(count);
  }

  /// Appends row v of the image, which becomes `below`; the row before it becomes `above`.
  void add(std::int64_t v) {
    std::swap(above_, below_);
    const std::uint8_t* label = labels_ + v * image_.cols();
    std::int64_t begin = 0, end = image_.cols();
    while (begin < end && label[begin] == 0) ++begin;
    while (end > begin && label[end - 1] == 0) --end;
    below_.clear(begin, end);
    float *x = xyz_.data(), *y = x + image_.cols(), *z = y + image_.cols();
    image_.load_row(v, begin, end - begin, x, y, z);
    for (std::int64_t u = begin; u < end; ++u) {
      const std::int64_t i = u - begin;
      if (label[u] == 0 || std::isnan(z[i])) continue;
      if (label[u] >= kNumJoints) {
        throw InputError("labels: expected 0 to 24, got " + std::to_string(label[u]));
      }
      below_.vertex[u] = static_cast<std::int32_t>(bones_.size());
      bones_.push_back(label[u]);
      points_.insert(points_.end(), {x[i], y[i], z[i]});
      pixels_.insert(pixels_.end(), {static_cast<std::int32_t>(u), static_cast<std::int32_t>(v)});
    }
  }

  /// Range of columns u such that the cell between columns u and u + 1 of the two rows may have a
  /// vertex; the end is exclusive.
  [[nodiscard]] std::pair<std::int64_t, std::int64_t> cells() const {
    const std::int64_t begin = std::min(above_.begin, below_.begin);
    return {std::max<std::int64_t>(begin - 1, 0),
            std::min(std::max(above_.end, below_.end), image_.cols() - 1)};
  }
  [[nodiscard]] std::int32_t above(std::int64_t u) const { return above_.vertex[u]; }
  [[nodiscard]] std::int32_t below(std::int64_t u) const { return below_.vertex[u]; }

  [[nodiscard]] std::uint8_t bone(std::int32_t vertex) const { return bones_[vertex]; }
  [[nodiscard]] float depth(std::int32_t vertex) const { return points_[3 * vertex + 2]; }
  [[nodiscard]] Eigen::Vector3f point(std::int32_t vertex) const {
    return Eigen::Map<const Eigen::Vector3f>(&points_[3 * vertex]);
  }

  [[nodiscard]] AnimationMesh mesh(const std::vector<std::int32_t>& faces) && {
    return {rows_of<3>(points_), rows_of<2>(pixels_), std::move(bones_), rows_of<3>(faces)};
  }
  /// Upper bound of the number of vertices.
  [[nodiscard]] std::size_t capacity() const { return bones_.capacity(); }

 private:
  struct Row {
    explicit Row(std::int64_t cols) : vertex(cols, kNone), begin(cols) {}
    void clear(std::int64_t from, std::int64_t to) {
      if (begin < end) std::fill(vertex.begin() + begin, vertex.begin() + end, kNone);
      begin = from;
      end = to;
    }
    std::vector<std::int32_t> vertex;  ///< Vertex of each column, or kNone.
    std::int64_t begin, end = 0;       ///< Columns outside this range have no vertex.
  };

  const RangeImage& image_;
  const std::uint8_t* labels_;
  std::vector<float> xyz_, points_;
  std::vector<std::int32_t> pixels_;
  std::vector<std::uint8_t> bones_;
  Row above_, below_;
};

/// Triangles of cells whose depths are connected and whose bones may share a triangle.
class CellCutter {
 public:
  /// @param pairs  Null: all bones may.
  CellCutter(const VertexRows& vertices, const DepthStep& step, const BonePairs* pairs, bool flips)
      : vertices_(vertices), step_(step), pairs_(pairs), flips_(flips) {}

  void cut_row() {
    const auto [begin, end] = vertices_.cells();
    for (std::int64_t u = begin; u < end; ++u) cut(u);
  }

  std::vector<std::int32_t> faces;

 private:
  /// The cell between columns u and u + 1 of the two rows.
  void cut(std::int64_t u) {
    std::array<std::int32_t, 4> vertex = {vertices_.above(u), vertices_.above(u + 1),
                                          vertices_.below(u + 1), vertices_.below(u)};
    if (!flips_) std::swap(vertex[1], vertex[3]);  // as cell_corners()
    unsigned valid = 0;
    for (unsigned i = 0; i < 4; ++i) valid |= vertex[i] != VertexRows::kNone ? 1U << i : 0U;
    const CellCut way = cut_cell(valid, [&](int i, int j) {
      return (vertices_.point(vertex[i]) - vertices_.point(vertex[j])).squaredNorm();
    });
    if (way == CellCut::kNone) return;
    const bool is_plain = valid == 15 && is_of_one_bone(vertex) && connects(vertex);
    for (const auto& [i, j, k] : cell_triangles(way)) {
      const std::array<std::int32_t, 3> corner = {vertex[i], vertex[j], vertex[k]};
      if (!is_plain && !(connects(corner) && fits(corner))) continue;
      faces.insert(faces.end(), corner.begin(), corner.end());
    }
  }

  template <std::size_t kCount>
  [[nodiscard]] bool connects(const std::array<std::int32_t, kCount>& corner) const {
    float near = vertices_.depth(corner[0]), far = near;
    for (const std::int32_t vertex : corner) {
      near = std::min(near, vertices_.depth(vertex));
      far = std::max(far, vertices_.depth(vertex));
    }
    return step_.connects(near, far);
  }
  [[nodiscard]] bool is_of_one_bone(const std::array<std::int32_t, 4>& corner) const {
    const std::uint8_t bone = vertices_.bone(corner[0]);
    return bone == vertices_.bone(corner[1]) && bone == vertices_.bone(corner[2]) &&
           bone == vertices_.bone(corner[3]);
  }
  [[nodiscard]] bool fits(const std::array<std::int32_t, 3>& corner) const {
    return fits(corner[0], corner[1]) && fits(corner[1], corner[2]) && fits(corner[2], corner[0]);
  }
  [[nodiscard]] bool fits(std::int32_t a, std::int32_t b) const {
    const std::uint8_t one = vertices_.bone(a), other = vertices_.bone(b);
    return one == other || pairs_ == nullptr || pairs_->fit(one, other, vertices_.point(a));
  }

  const VertexRows& vertices_;
  const DepthStep& step_;
  const BonePairs* pairs_;
  bool flips_;
};

// --- Motions ------------------------------------------------------------------------------------

/// Spine, neck and head, collar bones, pelvis.
bool is_bone_of_trunk(std::size_t bone) {
  constexpr std::array<std::uint8_t, 8> kTrunk = {1, 2, 3, 4, 8, 12, 16, 20};
  return std::ranges::find(kTrunk, bone) != kTrunk.end();
}

/// The shortest rotation between two directions, computed from half angles: without trigonometric
/// functions the result has the same bits on every CPU. No value for opposite directions.
std::optional<Eigen::Quaterniond> shortest_turn(const Eigen::Vector3d& from,
                                                const Eigen::Vector3d& to) {
  const double cosine = from.dot(to);
  constexpr double kOpposite = -1.0 + 1e-9;
  if (!(cosine > kOpposite)) return {};
  const Eigen::Vector3d axis = from.cross(to);
  return Eigen::Quaterniond(1.0 + cosine, axis.x(), axis.y(), axis.z()).normalized();
}

/// Sets the motion x -> rotation (x - centre) + place, where `place` is the new place of the
/// centre.
void set_motion(BoneMotions& motions, std::size_t bone, const Eigen::Quaterniond& rotation,
                const Eigen::Vector3d& centre, const Eigen::Vector3d& place) {
  motions.rotation[bone] = rotation;
  motions.translation[bone] = place - rotation * centre;
  motions.moves[bone] = true;
}

// --- Skinning -----------------------------------------------------------------------------------

/// A change of polar angle and azimuth about the optical axis, as cosines and sines.
struct SphericalTurn {
  float cos_polar = 1.0F, sin_polar = 0.0F, cos_azimuth = 1.0F, sin_azimuth = 0.0F;

  static SphericalTurn between(const Eigen::Vector3f& from, const Eigen::Vector3f& to) {
    SphericalTurn turn;
    const float a = from.head<2>().norm(), b = to.head<2>().norm();
    // sin(p1 - p0), cos(p1 - p0) of polar angles with sin p = a / r and cos p = z / r.
    const float scale = from.norm() * to.norm();
    if (!(scale > 0.0F)) return turn;
    turn.cos_polar = (from.z() * to.z() + a * b) / scale;
    turn.sin_polar = (b * from.z() - to.z() * a) / scale;
    if (!(a * b > 0.0F)) return turn;  // a point on the axis has no azimuth
    turn.cos_azimuth = (from.x() * to.x() + from.y() * to.y()) / (a * b);
    turn.sin_azimuth = (from.x() * to.y() - from.y() * to.x()) / (a * b);
    return turn;
  }

  [[nodiscard]] Eigen::Vector3f operator()(const Eigen::Vector3f& v) const {
    const float a = v.head<2>().norm();
    const float a1 = a * cos_polar + v.z() * sin_polar;
    const float z1 = v.z() * cos_polar - a * sin_polar;
    // A vertex on the axis has no azimuth; it is treated as if it lay on the side of the x axis.
    const float cx = a > 0.0F ? v.x() / a : 1.0F, cy = a > 0.0F ? v.y() / a : 0.0F;
    return {a1 * (cx * cos_azimuth - cy * sin_azimuth), a1 * (cy * cos_azimuth + cx * sin_azimuth),
            z1};
  }
};

/// Motions in single precision, with the geometry of the bones that blending needs.
class AvatarSkin {
 public:
  AvatarSkin(const Skeleton& source, const BoneMotions& motions) : moves_(motions.moves) {
    for (std::size_t bone = 0; bone < kNumJoints; ++bone) {
      rotation_[bone] = motions.rotation[bone].toRotationMatrix().cast<float>();
      translation_[bone] = motions.translation[bone].cast<float>();
      const std::size_t parent = kJointParents[bone];
      const Eigen::Vector3f& end = source.positions[bone];
      start_[bone] = source.positions[parent];
      const Eigen::Vector3f along = end - start_[bone];
      const float length2 = along.squaredNorm();
      length_[bone] = std::sqrt(length2);
      if (length2 > 0.0F) along_[bone] = along / length2;
      spherical_[bone] = SphericalTurn::between(along, rotation_[bone] * along);
    }
    for (std::size_t bone = 1; bone < kNumJoints; ++bone) {
      children_[kJointParents[bone]][num_children_[kJointParents[bone]]++] =
          static_cast<std::uint8_t>(bone);
    }
  }

  [[nodiscard]] Eigen::Vector3f rigid(std::size_t bone, const Eigen::Vector3f& v) const {
    return moves_[bone] ? Eigen::Vector3f(rotation_[bone] * v + translation_[bone]) : v;
  }

  [[nodiscard]] Eigen::Vector3f spherical(std::size_t bone, const Eigen::Vector3f& v) const {
    if (!moves_[bone]) return v;
    const Eigen::Vector3f& joint = start_[bone];
    return spherical_[bone](v - joint) + rigid(bone, joint);
  }

  [[nodiscard]] Eigen::Vector3f lbs(std::size_t bone, const Eigen::Vector3f& v) const {
    const Partner partner = partner_of(bone, v);
    if (!(partner.weight > 0.0F)) return rigid(bone, v);
    if (!moves_[bone] && !moves_[partner.bone]) return v;
    return (1.0F - partner.weight) * rigid(bone, v) + partner.weight * rigid(partner.bone, v);
  }

 private:
  struct Partner {
    std::size_t bone = 0;
    float weight = 0.0F;
    void consider(std::size_t other, float distance, float length) {
      constexpr float kShare = 0.2F;  // share of a bone's length that is blended at each end
      const float w = 0.5F * (1.0F - distance / (kShare * length));
      if (w > weight) *this = {other, w};
    }
  };

  /// The bone to blend with at a point near the end of a bone, and its weight.
  [[nodiscard]] Partner partner_of(std::size_t bone, const Eigen::Vector3f& v) const {
    Partner partner;
    const float length = length_[bone];
    if (!(length > 0.0F)) return partner;
    const float at = std::clamp((v - start_[bone]).dot(along_[bone]), 0.0F, 1.0F);
    partner.consider(kJointParents[bone], at * length, length);
    for (std::size_t i = 0; i < num_children_[bone]; ++i) {
      partner.consider(children_[bone][i], (1.0F - at) * length, length);
    }
    // Limbs start at joints inside the trunk, near which points of the trunk lie.
    if (is_bone_of_trunk(bone)) {
      for (const std::size_t limb : {5U, 9U, 13U, 17U}) {
        partner.consider(limb, (v - start_[limb]).norm(), length_[limb]);
      }
    }
    return partner;
  }

  std::array<Eigen::Matrix3f, kNumJoints> rotation_;
  std::array<Eigen::Vector3f, kNumJoints> translation_, start_;
  std::array<Eigen::Vector3f, kNumJoints> along_ = zeros();
  std::array<float, kNumJoints> length_{};
  std::array<SphericalTurn, kNumJoints> spherical_;
  std::array<std::array<std::uint8_t, kNumJoints>, kNumJoints> children_{};
  std::array<std::size_t, kNumJoints> num_children_{};
  std::array<bool, kNumJoints> moves_;

  static std::array<Eigen::Vector3f, kNumJoints> zeros() {
    std::array<Eigen::Vector3f, kNumJoints> all;
    all.fill(Eigen::Vector3f::Zero());
    return all;
  }
};

}  // namespace

AnimationMesh animation_mesh(const DepthView& depth, const PixelRays& rays, double focal,
                             const std::uint8_t* labels, const Skeleton* skeleton,
                             const AnimationMeshOptions& options) {
  if (!(options.joint_reach >= 0.0)) {
    throw InputError("joint_reach: expected >= 0, got " + number_text(options.joint_reach));
  }
  const RangeImage image(depth, rays);
  const DepthStep step(options.step, focal);
  const BonePairs pairs(skeleton, options.joint_reach);
  VertexRows vertices(image, labels);
  CellCutter cutter(vertices, step, options.by_label ? &pairs : nullptr, rays.flips());
  cutter.faces.reserve(6 * vertices.capacity());
  for (std::int64_t v = 0; v < depth.rows; ++v) {
    vertices.add(v);
    cutter.cut_row();
  }
  return std::move(vertices).mesh(cutter.faces);
}

std::optional<BoneMotions> follow_pose(const Skeleton& source, const Skeleton& pose,
                                       PoseScope scope) {
  const auto own = torso_frame(source), other = torso_frame(pose);
  if (!own || !other) return {};
  const Eigen::Matrix3d turn = (*own * other->transpose()).cast<double>();
  BoneMotions motions;
  if (scope == PoseScope::kBody) {
    const Eigen::Vector3d base = source[Joint::kSpineBase].cast<double>();
    set_motion(motions, 0, Eigen::Quaterniond(turn.transpose()).normalized(), base, base);
  }
  for (const std::size_t bone : kJointsOutwards) {
    if (bone == 0) continue;
    const std::size_t joint = kJointParents[bone];
    motions.rotation[bone] = motions.rotation[joint];
    motions.translation[bone] = motions.translation[joint];
    motions.moves[bone] = motions.moves[joint];
    if (scope == PoseScope::kLimbs && is_bone_of_trunk(bone)) continue;
    const auto from = bone_direction(source, bone), to = bone_direction(pose, bone);
    if (!from || !to) continue;
    const Eigen::Vector3d wanted = scope == PoseScope::kLimbs ? Eigen::Vector3d(turn * *to) : *to;
    const auto further = shortest_turn(motions.rotation[joint] * *from, wanted);
    if (!further) continue;
    const Eigen::Vector3d centre = source.positions[joint].cast<double>();
    const Eigen::Quaterniond rotation = (*further * motions.rotation[joint]).normalized();
    set_motion(motions, bone, rotation, centre, motions.apply(joint, centre));
  }
  return motions;
}

void animate(const float* vertices, const std::uint8_t* labels, std::int64_t count,
             const Skeleton& source, const BoneMotions& motions, Skinning method, float* out) {
  const AvatarSkin skin(source, motions);
  for (std::int64_t i = 0; i < count; ++i) {
    const Eigen::Vector3f v = Eigen::Map<const Eigen::Vector3f>(vertices + 3 * i);
    const std::size_t bone = labels[i];
    Eigen::Map<Eigen::Vector3f> to(out + 3 * i);
    switch (method) {
      case Skinning::kSpherical:
        to = skin.spherical(bone, v);
        break;
      case Skinning::kRigid:
        to = skin.rigid(bone, v);
        break;
      case Skinning::kLbs:
        to = skin.lbs(bone, v);
        break;
    }
  }
}

}  // namespace manip3d

#include "io/gltf_deformation.hpp"

#include <algorithm>
#include <array>
#include <limits>
#include <map>
#include <nlohmann/json.hpp>
#include <string_view>

#include "manip3d/error.hpp"

namespace manip3d {
namespace {

constexpr std::int64_t kInfluenceBytes = sizeof(std::uint16_t) + sizeof(float);
constexpr std::int64_t kInSet = 4;  // joints per vertex in each of JOINTS_0, JOINTS_1, ...

std::string in_set(const char* name, std::int64_t set) {
  return std::string(name) + "_" + std::to_string(set);
}

std::int64_t num_sets(const JsonPlace& attributes) {
  std::int64_t sets = 0;
  while (attributes.has(in_set("JOINTS", sets).c_str())) ++sets;
  return sets;
}

std::int64_t num_targets(const JsonPlace& primitive) {
  const auto targets = primitive.find("targets");
  return targets ? targets->size() : 0;
}

/// The accessors that deform a primitive, by the names of their attributes.
JsonPlace::Json movers_of(const JsonPlace& primitive) {
  JsonPlace::Json movers = JsonPlace::Json::object();
  for (const auto& [name, accessor] : primitive.member("attributes").value().items()) {
    if (name.starts_with("JOINTS_") || name.starts_with("WEIGHTS_")) movers[name] = accessor;
  }
  if (const auto targets = primitive.find("targets")) movers["targets"] = targets->value();
  return movers;
}

/// The name of an attribute that morph targets change and that other triangles cannot take over;
/// empty: none.
std::string changed_attribute(const JsonPlace& primitive) {
  constexpr std::array<std::string_view, 3> kMoved = {"POSITION", "NORMAL", "TANGENT"};
  const auto targets = primitive.find("targets");
  for (std::int64_t t = 0; targets && t < targets->size(); ++t) {
    for (const auto& [name, accessor] : targets->item(t).value().items()) {
      if (std::find(kMoved.begin(), kMoved.end(), name) == kMoved.end()) return name;
    }
  }
  return "";
}

/// Copies an attribute of `width` numbers to the rows of its primitive.
class RowReader {
 public:
  RowReader(GltfDocument& document, const PlacedPrimitive& primitive)
      : document_(document), primitive_(primitive) {}

  /// @return  Its values, row by row; empty if the object does not have it.
  std::vector<double> read(const JsonPlace& owner, const std::string& name, int width) {
    const auto user = owner.find(name.c_str());
    if (!user) return {};
    const GltfAccessor& accessor = document_.accessor(*user);
    if (accessor.num_components != width) accessor.place.fail("the type does not suit " + name);
    if (accessor.count != primitive_.num_vertices) {
      accessor.place.fail("has " + std::to_string(accessor.count) + " elements, POSITION of " +
                          primitive_.place.pointer() + " " +
                          std::to_string(primitive_.num_vertices));
    }
    std::vector<double> values(accessor.count * width);
    accessor.decode(values.data());
    return values;
  }

 private:
  GltfDocument& document_;
  const PlacedPrimitive& primitive_;
};

std::uint16_t joint_of(double value, const JsonPlace& place) {
  if (value >= 0.0 && value <= std::numeric_limits<std::uint16_t>::max() &&
      value == static_cast<double>(static_cast<std::uint16_t>(value))) {
    return static_cast<std::uint16_t>(value);
  }
  place.fail("expected joints as integers from 0 to 65535, got " + number_text(value));
}

void read_joints(GltfDocument& document, const PlacedPrimitive& primitive, Deformation& out) {
  const JsonPlace attributes = primitive.place.member("attributes");
  RowReader rows(document, primitive);
  for (std::int64_t set = 0; set < num_sets(attributes); ++set) {
    const std::string name = in_set("JOINTS", set);
    const std::vector<double> joints = rows.read(attributes, name, kInSet);
    const std::vector<double> weights = rows.read(attributes, in_set("WEIGHTS", set), kInSet);
    for (std::int64_t i = 0; i < std::ssize(joints); ++i) {
      const std::int64_t at =
          (primitive.first_vertex + i / kInSet) * out.num_influences + set * kInSet + i % kInSet;
      out.joints[at] = joint_of(joints[i], attributes.member(name.c_str()));
      out.weights[at] = weights.empty() ? 0.0F : static_cast<float>(weights[i]);
    }
  }
}

void read_targets(GltfDocument& document, const PlacedPrimitive& primitive,
                  std::int64_t num_vertices, Deformation& out) {
  RowReader rows(document, primitive);
  for (std::int64_t t = 0; t < out.num_targets; ++t) {
    const JsonPlace target = primitive.place.member("targets").item(t);
    const std::int64_t first = 3 * (t * num_vertices + primitive.first_vertex);
    const std::vector<double> moved = rows.read(target, "POSITION", 3);
    std::copy(moved.begin(), moved.end(), out.targets.begin() + first);
    const std::vector<double> turned = rows.read(target, "NORMAL", 3);
    if (!turned.empty()) {
      out.target_normals.resize(out.targets.size());
      std::copy(turned.begin(), turned.end(), out.target_normals.begin() + first);
    }
  }
}

}  // namespace

std::string reason_not_to_deform(const JsonPlace& primitives, bool has_skin) {
  std::map<std::string, JsonPlace::Json> movers;  // by the accessor of the positions
  for (std::int64_t i = 0; i < primitives.size(); ++i) {
    const JsonPlace place = primitives.item(i);
    const JsonPlace attributes = place.member("attributes");
    if (has_skin && !(attributes.has("JOINTS_0") && attributes.has("WEIGHTS_0"))) {
      return "it has a skin, but not all of it has joints and weights";
    }
    if (num_targets(place) != num_targets(primitives.item(0))) {
      return "its primitives have different numbers of morph targets";
    }
    const std::string changed = changed_attribute(place);
    if (!changed.empty()) return "its morph targets change " + changed;
    const auto position = attributes.find("POSITION");
    const std::string key = position ? position->value().dump() : "";
    const JsonPlace::Json own = movers_of(place);
    const auto [known, is_new] = movers.try_emplace(key, own);
    if (!is_new && known->second != own) {
      return "its primitives share positions, but not joints and morph targets";
    }
  }
  return "";
}

Deformation read_influences(GltfDocument& document, const JsonPlace& primitive,
                            std::int64_t num_vertices, GltfBudget& budget) {
  Deformation deformation;
  deformation.num_influences = kInSet * num_sets(primitive.member("attributes"));
  budget.charge(num_vertices * deformation.num_influences * kInfluenceBytes, primitive.pointer());
  deformation.joints.resize(num_vertices * deformation.num_influences);
  deformation.weights.resize(deformation.joints.size());
  read_joints(document, {primitive, 0, num_vertices}, deformation);
  return deformation;
}

Deformation read_deformation(GltfDocument& document, const std::vector<PlacedPrimitive>& primitives,
                             std::int64_t num_vertices, GltfBudget& budget) {
  Deformation deformation;
  for (const PlacedPrimitive& primitive : primitives) {
    const std::int64_t influences = kInSet * num_sets(primitive.place.member("attributes"));
    deformation.num_influences = std::max(deformation.num_influences, influences);
    deformation.num_targets = num_targets(primitive.place);
    const std::int64_t per_vertex =
        influences * kInfluenceBytes +
        deformation.num_targets * 6 * static_cast<std::int64_t>(sizeof(float));
    budget.charge(primitive.num_vertices * per_vertex, primitive.place.pointer());
  }
  deformation.joints.resize(num_vertices * deformation.num_influences);
  deformation.weights.resize(deformation.joints.size());
  deformation.targets.resize(3 * num_vertices * deformation.num_targets);
  for (const PlacedPrimitive& primitive : primitives) {
    read_joints(document, primitive, deformation);
    read_targets(document, primitive, num_vertices, deformation);
  }
  return deformation;
}

}  // namespace manip3d

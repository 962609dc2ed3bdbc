#include "authenticate/watermark_verdict.hpp"

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "authenticate/watermark_suite.hpp"
#include "authenticate/watermark_tiles.hpp"

namespace manip3d {
namespace {

template <typename T>
bool contains(const std::vector<T>& values, const T& value) {
  return std::find(values.begin(), values.end(), value) != values.end();
}

// Says what was changed in a tampered frame.
std::string reason_of_tampering(const WatermarkFinding& finding) {
  const auto count = [&](WatermarkTile tile) {
    return std::count(finding.tiles.begin(), finding.tiles.end(), tile);
  };
  const auto changed = count(WatermarkTile::kChanged), bits = count(WatermarkTile::kBits);
  const std::string total = " of " + std::to_string(finding.tiles.size()) + " tiles";
  if (changed > 0) {
    const bool has_intensity = finding.header && finding.header->has_intensity;
    return (has_intensity ? "points or intensities of " : "points of ") + std::to_string(changed) +
           total + " are not those that were signed";
  }
  if (bits > 0) return "carrier bits of " + std::to_string(bits) + total + " were changed";
  if (finding.picture_changed) return "the picture is not the one that was signed";
  return "the scan has other columns or points than were signed";
}

std::string reason_of_gap(std::int64_t missing) {
  if (missing <= 0) {
    return "the content holds, but the frame is of another session than the one before it";
  }
  if (missing == 1) return "the content holds, but the frame before it is missing";
  return "the content holds, but " + std::to_string(missing) + " frames before it are missing";
}

}  // namespace

std::string objection(const WatermarkPolicy& policy, const WatermarkHeader& header) {
  if (!contains(policy.embeddings, header.embedding)) return "the policy refuses this embedding";
  if (!contains(policy.carriers, header.carrier)) return "the policy refuses this carrier";
  if (!policy.sensors.empty() && !contains(policy.sensors, header.sensor)) {
    return "the record is of another sensor than the policy names";
  }
  if (!policy.sessions.empty() && !contains(policy.sessions, header.session)) {
    return "the record is of another session than the policy names";
  }
  const bool carries = header.embedding != WatermarkEmbedding::kDetached;
  if (carries && !policy.units_per_m.empty() && !contains(policy.units_per_m, header.units_per_m)) {
    return "the policy refuses this lattice";
  }
  if (policy.context && !header.has_context) return "the record binds no context";
  if (policy.context && !equal_in_constant_time(*policy.context, header.context)) {
    return "the record belongs to another context";
  }
  return {};
}

WatermarkFreshness freshness_of(const WatermarkPolicy& policy, const WatermarkHeader& header,
                                std::int64_t now_ns) {
  if (policy.max_age_ns <= 0) return WatermarkFreshness::kUnknown;
  const double age = static_cast<double>(now_ns) - static_cast<double>(header.time_ns);
  const auto most = static_cast<double>(policy.max_age_ns);
  return std::abs(age) <= most ? WatermarkFreshness::kFresh : WatermarkFreshness::kStale;
}

std::string missing_part(const WatermarkHeader& header, bool has_picture, bool is_exact) {
  if ((header.carrier == kInPicture) != has_picture) {
    return has_picture ? "the record is not one that a picture carries"
                       : "the record binds the picture that carries it, which is not here";
  }
  if (header.is_exact && !is_exact) {
    return "coordinates were signed in float64, of which the scan has the float32 part only";
  }
  return {};
}

void conclude(const WatermarkPolicy& policy, std::int64_t now_ns, WatermarkFinding& finding) {
  const auto say = [&](WatermarkVerdict verdict, std::string reason) {
    finding.verdict = verdict;
    finding.reason = std::move(reason);
  };
  using enum WatermarkVerdict;
  if (finding.content == WatermarkContent::kTampered) {
    say(kTampered, reason_of_tampering(finding));
  } else if (finding.is_of_older_key) {
    say(kTampered, "the frame was signed with a key that the stream had replaced");
  } else if (finding.order == WatermarkPlace::kReplay) {
    say(kTampered, "the frame was seen before, or comes after a later one");
  } else if (finding.content == WatermarkContent::kUnverifiable) {
    say(kUnverifiable, "intensities were signed, and the scan has none");
  } else if (finding.order == WatermarkPlace::kGap) {
    say(kUnverifiable, reason_of_gap(finding.gap));
  } else if (finding.freshness == WatermarkFreshness::kStale) {
    const bool is_to_come = finding.header->time_ns > now_ns;
    say(kUnverifiable, is_to_come ? "the content holds, but the frame states a time to come"
                                  : "the content holds, but the frame is too old");
  } else if (finding.order == WatermarkPlace::kUnknown && !policy.any_order) {
    say(kUnverifiable, "the content holds, but the frame's place in the stream is not known");
  } else {
    say(kAuthentic, "every point is the one that was signed");
  }
}

}  // namespace manip3d

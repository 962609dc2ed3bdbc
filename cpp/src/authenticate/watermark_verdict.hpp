#pragma once

#include <cstdint>
#include <string>

#include "manip3d/authenticate/watermark.hpp"

/// @file
/// The verdict of a policy on a record and a scan.
namespace manip3d {

/// Why the policy refuses the record; empty if it accepts it.
std::string objection(const WatermarkPolicy& policy, const WatermarkHeader& header);

WatermarkFreshness freshness_of(const WatermarkPolicy& policy, const WatermarkHeader& header,
                                std::int64_t now_ns);

/// Which part that the record binds is missing in the scan; empty if none is.
std::string missing_part(const WatermarkHeader& header, bool has_picture, bool is_exact);

/// Sets verdict and reason. The checks are in order of priority: the first finding is the reason.
void conclude(const WatermarkPolicy& policy, WatermarkFinding& finding);

}  // namespace manip3d

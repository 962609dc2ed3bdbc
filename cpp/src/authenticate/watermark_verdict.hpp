#pragma once

#include <cstdint>
#include <string>

#include "manip3d/authenticate/watermark.hpp"

/// @file
/// The verdict of a policy on a record and a scan.
namespace manip3d {

/// Reason why the policy refuses the record; empty if it accepts it.
std::string objection(const WatermarkPolicy& policy, const WatermarkHeader& header);

WatermarkFreshness freshness_of(const WatermarkPolicy& policy, const WatermarkHeader& header,
                                std::int64_t now_ns);

/// Part that the record binds and the scan lacks; empty if the scan has all of them.
std::string missing_part(const WatermarkHeader& header, bool has_picture, bool is_exact);

/// Sets verdict and reason. The checks are in order of priority: the first finding is the reason.
void conclude(const WatermarkPolicy& policy, std::int64_t now_ns, WatermarkFinding& finding);

}  // namespace manip3d

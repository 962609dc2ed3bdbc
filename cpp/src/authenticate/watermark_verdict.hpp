#pragma once

#include <cstdint>
#include <string>

#include "manip3d/authenticate/watermark.hpp"

/// @file
/// The verdict of a policy on a record and on what was found in a scan.
namespace manip3d {

/// Why the policy does not accept the record; empty: it does.
std::string objection(const WatermarkPolicy& policy, const WatermarkHeader& header);

WatermarkFreshness freshness_of(const WatermarkPolicy& policy, const WatermarkHeader& header,
                                std::int64_t now_ns);

/// Says what the record binds and the scan does not have; empty: it has all.
std::string missing_part(const WatermarkHeader& header, bool has_picture, bool is_exact);

/// Sets verdict and reason; what is found first here explains what comes after it.
void conclude(const WatermarkPolicy& policy, WatermarkFinding& finding);

}  // namespace manip3d

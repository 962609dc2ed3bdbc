#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "manip3d/authenticate/cross_modal.hpp"

namespace manip3d {

/// A point of the scan, and the surface that the cameras see in its direction.
struct ContradictedPoint {
  std::int32_t row = 0;
  Eigen::Vector3d seen = Eigen::Vector3d::Zero();  ///< That surface, in the LiDAR's frame, metres.
  double difference = 0.0;                         ///< LiDAR minus cameras, pixels of disparity.
};

/// Points close together, most of which the cameras contradict.
struct ContradictedObject {
  bool added = false;                     ///< Most lie before what the cameras see; else behind it.
  std::vector<ContradictedPoint> points;  ///< The contradicted ones; rows ascending.
};

/// Objects of which most points lie elsewhere than the disparity at their pixels says.
///
/// A point is asked where the left camera sees it, that is, where no point that is nearer to the
/// camera lies beside it in the picture. It is contradicted where all disparities of the 3x3 pixels
/// around it differ by more than `point_tolerance` and the pixels that `point_depth_tolerance`
/// metres make at its depth. Contradicted points in touching cubes of half a metre are an object if
/// there are `min_points` of them, at least `min_share` of all points asked there, and at least
/// `min_of_others` times as many as everywhere else in the picture: where cameras and scan fit
/// badly as a whole, as in leaves or glass, one object has to stand out.
std::vector<ContradictedObject> find_contradicted_objects(const PointsView& view,
                                                          const DisparityView& disparity,
                                                          const StereoView& camera,
                                                          const CrossModalOptions& options,
                                                          const Progress& progress);

}  // namespace manip3d

#include "modify/border_memory.hpp"

namespace manip3d {

void BorderMemory::reserve(std::size_t num_pixels) {
  shown_.reserve(num_pixels);
  shown_before_.reserve(num_pixels);
}

PixelBox BorderMemory::fill(const PixelBox& box, double time_s, const PixelRays& rays,
                            const PhantomImage& image, std::vector<HoleFill>& fills) {
  constexpr double kLatest = 0.1;  // seconds; an older frame is not used
  const bool is_known = time_s - time_s_ <= kLatest;
  shown_before_.swap(shown_);
  list_phantom(box, image, shown_);
  time_s_ = time_s;
  fills.clear();
  return is_known ? fill_remembered(shown_before_, rays, image, fills) : PixelBox{};
}

}  // namespace manip3d

#include "modules.hpp"

namespace manip3d::bindings {

void bind_metrics(pybind11::module_& m) { static_cast<void>(m); }

}  // namespace manip3d::bindings

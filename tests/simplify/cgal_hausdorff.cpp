/// Two-sided Hausdorff distances by CGAL, one a line: PROGRAM ERROR FIRST.off SECOND.off ...
#include <CGAL/Polygon_mesh_processing/IO/polygon_mesh_io.h>
#include <CGAL/Polygon_mesh_processing/distance.h>
#include <CGAL/Simple_cartesian.h>
#include <CGAL/Surface_mesh.h>

#include <cstdlib>
#include <iostream>

namespace pmp = CGAL::Polygon_mesh_processing;
using Surface = CGAL::Surface_mesh<CGAL::Simple_cartesian<double>::Point_3>;

int main(int argc, char** argv) {
  std::cout.precision(17);
  const double error = std::atof(argv[1]);
  for (int i = 2; i + 1 < argc; i += 2) {
    Surface first, second;
    if (!pmp::IO::read_polygon_mesh(argv[i], first) ||
        !pmp::IO::read_polygon_mesh(argv[i + 1], second)) {
      return EXIT_FAILURE;
    }
    std::cout << pmp::bounded_error_symmetric_Hausdorff_distance<CGAL::Sequential_tag>(
                     first, second, error)
              << std::endl;
  }
  return EXIT_SUCCESS;
}

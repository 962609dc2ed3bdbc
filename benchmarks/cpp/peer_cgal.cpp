/// CGAL's edge collapse: Garland-Heckbert (plane quadrics, optimal placement) and Lindstrom-Turk,
/// both with the library's own defaults. It takes oriented manifold surfaces only.
#include <CGAL/Polygon_mesh_processing/polygon_soup_to_polygon_mesh.h>
#include <CGAL/Simple_cartesian.h>
#include <CGAL/Surface_mesh.h>
#include <CGAL/Surface_mesh_simplification/Policies/Edge_collapse/GarlandHeckbert_policies.h>
#include <CGAL/Surface_mesh_simplification/Policies/Edge_collapse/LindstromTurk_cost.h>
#include <CGAL/Surface_mesh_simplification/Policies/Edge_collapse/LindstromTurk_placement.h>
#include <CGAL/Surface_mesh_simplification/edge_collapse.h>

#include <array>
#include <vector>

#include "peer.hpp"

namespace {

namespace pmp = CGAL::Polygon_mesh_processing;
namespace sms = CGAL::Surface_mesh_simplification;
using Kernel = CGAL::Simple_cartesian<double>;
using Point = Kernel::Point_3;
using Surface = CGAL::Surface_mesh<Point>;
using manip3d::TriangleMesh;

/// CGAL's own predicates count edges; the other libraries count faces.
struct StopAtFaces {
  std::size_t target;
  template <typename Cost, typename Profile>
  bool operator()(const Cost&, const Profile& profile, std::size_t, std::size_t) const {
    return profile.surface_mesh().number_of_faces() <= target;
  }
};

Surface to_surface(const TriangleMesh& mesh) {
  std::vector<Point> points;
  for (const auto& p : mesh.vertices.rowwise()) points.emplace_back(p(0), p(1), p(2));
  std::vector<std::array<std::size_t, 3>> triangles;
  for (const auto& f : mesh.faces.rowwise()) {
    triangles.push_back({static_cast<std::size_t>(f(0)), static_cast<std::size_t>(f(1)),
                         static_cast<std::size_t>(f(2))});
  }
  if (!pmp::is_polygon_soup_a_polygon_mesh(triangles)) {
    throw peers::Refusal{"needs an oriented manifold mesh"};
  }
  Surface surface;
  pmp::polygon_soup_to_polygon_mesh(points, triangles, surface);
  return surface;
}

TriangleMesh from_surface(Surface& surface) {
  surface.collect_garbage();
  TriangleMesh mesh;
  mesh.vertices.resize(static_cast<Eigen::Index>(surface.number_of_vertices()), 3);
  for (const auto v : surface.vertices()) {
    const Point& p = surface.point(v);
    mesh.vertices.row(static_cast<Eigen::Index>(v.idx())) << p.x(), p.y(), p.z();
  }
  mesh.faces.resize(static_cast<Eigen::Index>(surface.number_of_faces()), 3);
  for (const auto f : surface.faces()) {
    int corner = 0;
    for (const auto v : surface.vertices_around_face(surface.halfedge(f))) {
      mesh.faces(static_cast<Eigen::Index>(f.idx()), corner++) = static_cast<std::int32_t>(v.idx());
    }
  }
  return mesh;
}

void garland_heckbert(Surface& surface, const StopAtFaces& stop) {
  const sms::GarlandHeckbert_policies<Surface, Kernel> policies(surface);
  sms::edge_collapse(
      surface, stop,
      CGAL::parameters::get_cost(policies.get_cost()).get_placement(policies.get_placement()));
}

void lindstrom_turk(Surface& surface, const StopAtFaces& stop) {
  sms::edge_collapse(surface, stop,
                     CGAL::parameters::get_cost(sms::LindstromTurk_cost<Surface>())
                         .get_placement(sms::LindstromTurk_placement<Surface>()));
}

peers::Method method_of(void (*collapse)(Surface&, const StopAtFaces&)) {
  return [=](const TriangleMesh& input, std::int64_t target, peers::Cost& cost) {
    Surface surface = to_surface(input);
    cost = peers::measure([&] { collapse(surface, {static_cast<std::size_t>(target)}); });
    return from_surface(surface);
  };
}

peers::Method find_method(const std::string& name) {
  if (name == "garland-heckbert") return method_of(garland_heckbert);
  if (name == "lindstrom-turk") return method_of(lindstrom_turk);
  return {};
}

}  // namespace

int main(int argc, char** argv) { return peers::peer_main(argc, argv, find_method); }

#pragma once

#include <cstdint>
#include <vector>

#include "simplify/pieces.hpp"
#include "simplify/quality_original.hpp"

namespace manip3d::quality_detail {

/// A collapse: where the new vertex lies and what it costs.
struct Plan {
  double price = 0.0;  // per face that goes
  Vector3d position = Vector3d::Zero();
  double owed = 0.0;  // for borders and texture, since the beginning
};

enum class Place : std::uint8_t { kBest, kFirst, kSecond, kMiddle };

/// A textured wedge of the vertex that two become.
struct Textured {
  std::int32_t wedge;
  AttributeQuadric quadric;
  bool stays = false;  // it still has faces then
};

/// The wedges of the vertex that v and t become, as two of the mesh's vertices are looked at.
class JoinedWedges {
 public:
  JoinedWedges(const CollapseMesh& mesh, const Original& original)
      : mesh_(mesh), original_(original) {}

  void gather(std::int32_t v, std::int32_t t);
  /// Which wedge each one of v becomes: that of t across a face on the edge; others stay.
  [[nodiscard]] const WedgeMap& map() const { return map_; }
  /// The wedges with a texture, with their quadrics; none where the texture does not count.
  [[nodiscard]] const std::vector<Textured>& textured() const { return textured_; }
  /// The price of the texture if the vertex lies at p. Where a wedge loses its last face, what is
  /// left of its surface shows the one that is most like it.
  [[nodiscard]] double price(const Vector3d& p) const;

 private:
  void map_wedges(std::int32_t v, std::int32_t t);
  void gather_textured(std::int32_t v, std::int32_t t);

  const CollapseMesh& mesh_;
  const Original& original_;
  WedgeMap map_;
  std::vector<Textured> textured_;
};

/// The prices of collapses and of whole pieces.
class Prices {
 public:
  Prices(const CollapseMesh& mesh, const Original& original, const Kept& kept,
         const Pieces& pieces);

  Plan plan(std::int32_t v, std::int32_t t, std::int32_t num_edge_faces, Place place);

  /// All edges of v are priced next: its own faces are looked at once.
  void begin_edges(std::int32_t v);
  void end_edges() { center_ = -1; }

  /// The price of a collapse among the last faces of a piece, measured: how much farther from its
  /// faces the original surface of the piece is afterwards on average, over its area. The planes
  /// around an edge do not tell: front and back of a shell can fold onto each other in all of them.
  [[nodiscard]] double lost_shape(std::int32_t v, std::int32_t t, const Vector3d& p);

  /// The price of faces on an edge that leave nothing behind: where a strip is one face wide, no
  /// others stand for it, as they do for faces that a collapse folds onto their neighbours. A tube
  /// that has become a strip of two sides could vanish between two pinches otherwise, since the
  /// planes around its last edge hold nothing within them.
  [[nodiscard]] double lost_strip(std::int32_t v, std::int32_t t, const Vector3d& p) const;

  /// The price of a whole piece, per face that goes, but for no more than `most_faces`: those
  /// beyond the target gain nothing.
  [[nodiscard]] double piece(std::int32_t piece, std::int64_t most_faces) const;

 private:
  /// The faces around an edge as they are now: their quadric and area, and the plane
  /// normal.p = offset on which the volume below them stays the same [Lindstrom & Turk 1998].
  struct Star {
    Quadric quadric;
    double area = 0.0;
    Vector3d normal = Vector3d::Zero();
    double offset = 0.0;
  };
  /// A face with its part in a star.
  struct StarFace {
    Vector3d normal;  // twice the area long
    double offset = 0.0, area = 0.0;
    Quadric quadric;

    void add_to(Star& star) const {
      star.normal += normal;
      star.offset += offset;
      if (!(area > 0.0)) return;
      star.quadric += quadric;
      star.area += area;
    }
  };
  /// The borders of a piece of the input, which go with it.
  struct PieceBorders {
    double length = 0.0;      // of its boundaries and seams, times their weights
    double area = 0.0;        // of its faces
    double importance = 0.0;  // the largest of its vertices
  };

  [[nodiscard]] StarFace star_face(std::int32_t f, const Vector3d& p) const;
  [[nodiscard]] Star star_of(std::int32_t v, std::int32_t t) const;
  [[nodiscard]] Vector3d position(std::int32_t v, std::int32_t t, Place place, const Star& star,
                                  const Quadric& borders, double length) const;
  [[nodiscard]] double spike(std::int32_t v, std::int32_t t, const Vector3d& p) const;
  void gather_piece(std::int32_t v);

  const CollapseMesh& mesh_;
  const Original& original_;
  const Kept& kept_;
  const Pieces& pieces_;
  std::vector<PieceBorders> piece_borders_;
  JoinedWedges wedges_;
  std::int32_t center_ = -1;  // the vertex whose edges are being priced, or -1
  Star center_star_;
  std::vector<StarFace> center_faces_;
  std::vector<std::int32_t> around_, last_faces_;
};

}  // namespace manip3d::quality_detail

#pragma once

#include <cstdint>
#include <vector>

#include "simplify/pieces.hpp"
#include "simplify/quality_original.hpp"

namespace manip3d::quality_detail {

/// A collapse: position of the new vertex and price.
struct Plan {
  double price = 0.0;  // per removed face
  Vector3d position = Vector3d::Zero();
  double attribute_price = 0.0;  // of borders, texture and colours, relative to the input
};

enum class Place : std::uint8_t { kBest, kFirst, kSecond, kMiddle };

/// A textured wedge of the merged vertex.
struct Textured {
  std::int32_t wedge;
  AttributeQuadric quadric;
  bool stays = false;  // it still has faces after the collapse
};

/// The wedges of the vertex into which v and t would be merged.
class JoinedWedges {
 public:
  JoinedWedges(const CollapseMesh& mesh, const Original& original)
      : mesh_(mesh), original_(original) {}

  void gather(std::int32_t v, std::int32_t t);
  /// For each wedge of v, the wedge that replaces it: that of t across a face on the edge; others
  /// stay.
  [[nodiscard]] const WedgeMap& map() const { return map_; }
  /// The textured wedges with their quadrics; none if the texture has no weight.
  [[nodiscard]] const std::vector<Textured>& textured() const { return textured_; }
  /// Price of the texture if the vertex is at p. If a wedge loses its last face, the rest of its
  /// surface shows the most similar wedge.
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

  /// Prepares pricing all edges of v, so that its own faces are evaluated only once.
  void begin_edges(std::int32_t v);
  void end_edges() { center_ = -1; }

  /// Measured price of a collapse among the last faces of a piece: the mean increase of the
  /// distance from the piece's original surface to its faces, times the area of that surface. The
  /// planes around an edge are not enough, because front and back of a shell can fold onto each
  /// other within all of them.
  [[nodiscard]] double lost_shape(std::int32_t v, std::int32_t t, const Vector3d& p);

  /// Price of faces on an edge that vanish without a replacement. If a strip is one face wide, no
  /// other faces represent it, in contrast to faces that a collapse folds onto their neighbours.
  /// Without this price, a tube that has become a two-sided strip could vanish between two pinches,
  /// because the planes around its last edge do not hold it within themselves.
  [[nodiscard]] double lost_strip(std::int32_t v, std::int32_t t, const Vector3d& p) const;

  /// Price of a whole piece, per removed face. At most `most_faces` count, because removing more
  /// than the target needs has no value.
  [[nodiscard]] double piece(std::int32_t piece, std::int64_t most_faces) const;

 private:
  /// The current faces around an edge: their quadric and area, and the plane normal.p = offset on
  /// which the enclosed volume does not change [Lindstrom & Turk 1998].
  struct Star {
    Quadric quadric;
    double area = 0.0;
    Vector3d normal = Vector3d::Zero();
    double offset = 0.0;
  };
  /// A face with its contribution to a star.
  struct StarFace {
    Vector3d normal;  // its length is twice the area
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
  /// The borders of a piece of the input, which vanish with it.
  struct PieceBorders {
    double length = 0.0;      // total length of its boundaries and seams, times their weights
    double area = 0.0;        // total area of its faces
    double importance = 0.0;  // largest importance of its vertices
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
  std::int32_t center_ = -1;  // vertex whose edges are being priced, or -1
  Star center_star_;
  std::vector<StarFace> center_faces_;
  std::vector<std::int32_t> around_, last_faces_;
};

}  // namespace manip3d::quality_detail

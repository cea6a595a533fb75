// A rigid convex geom that may touch the tissue, seen from the bone.
#pragma once
#include <mujoco/mujoco.h>

// Parts of the robot: what is meant to touch, what else is fixed to the same body, and all other bodies.
enum { PART_TIP, PART_HAND, PART_LINKS };

typedef struct {
  int geom, body, type;
  int part;
  double size[3];    // as MuJoCo's geom_size
  double bound;      // radius of a sphere about the geom's centre that holds it [m]
  double box[6];     // centre and half sizes of its box, in its own frame
  int nplane;        // of a mesh: half-spaces n . x <= o of its convex hull, in its own frame
  double* plane;     // (nplane, 4)
  int faced;         // whether it has faces that meet in rims, and is not round everywhere
  double give;       // how far its own surface gives way under pressure [m/Pa]; 0 if rigid
  int near;          // whether it may touch the region in this step
  // In the bone's frame, set once a step by tool_place:
  double centre[3], axes[9];
  double shift[3], turn[3];  // how far its centre moved in the last step against the bone [m], and turned [rad]
} Tool;

// Returns 0, or -1 for a geom that has no surface here. tool_free comes after both.
int tool_init(const mjModel* m, int geom, Tool* tool);
void tool_free(Tool* tool);

// Where the tool is and how it moves against the bone.
void tool_place(const mjModel* m, const mjData* d, int bone, double dt, Tool* tool);

// About the distance from a point (bone's frame) to the tool's surface, never much too large; 0 or less inside.
double tool_distance(const Tool* tool, const double point[3]);

// The signed distance from a point to the tool's surface, negative inside, and the outward normal at its foot there. The
// foot is the one that is found from where a ray from the point along a unit direction leaves the tool. A point so deep
// that the walk from there does not end, as beside the wall of a flat tool, has the distance to the tangent plane there.
// Returns 0 where the point is farther outside than `farthest`, and otherwise also how far on the ray the tool begins: 1
// for a distance, and 2 for one to a tangent plane.
int tool_gap(const Tool* tool, const double point[3], const double direction[3], double farthest, double* begins,
             double* gap, double normal[3]);

// For a point inside, the signed distance to the tangent plane where the ray leaves the tool. Returns 0 where it misses it.
int tool_below(const Tool* tool, const double point[3], const double direction[3], double* begins, double* gap,
               double normal[3]);

// How far the surface bends away from its tangent plane at a foot on it (bone's frame), at an offset along that plane [m].
// Rims, and hulls of meshes, count as flat: they are narrower than a triangle, or not known to be round.
double tool_bend(const Tool* tool, const double foot[3], const double normal[3], const double offset[3]);

// About the signed distance from a point to the surface of a tool without faces, and there the outward normal and the sum
// of both curvatures [1/m].
double tool_round(const Tool* tool, const double point[3], double normal[3], double* bend);

// How far the tool's material at a point moved in the last step against the bone.
void tool_shift(const Tool* tool, const double point[3], double out[3]);

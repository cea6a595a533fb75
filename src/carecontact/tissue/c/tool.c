#include "tool.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "vec.h"

static const double PARALLEL = 1e-12;
// Edges of boxes and cylinders are rounded with this radius [m], and those of hulls with nearly 3 SOFTNESS: skin that
// slides over a sharp edge would jump, and with it the force.
static const double EDGE = 0.002, SOFTNESS = 0.0008;
static const int NEWTON_STEPS = 12, FOOT_STEPS = 8;
static const double FOOT_NEAR = 1e-5;  // [m] beside the foot by this, a gap is wrong by its square over a radius
static const double SAME_WALL = 0.1;  // cosine between two normals of one wall or rim

// Half-spaces of a mesh's convex hull. MuJoCo keeps the hull as a graph: counts, then four tables (mjModel.mesh_graph).
static int hull_planes(const mjModel* m, int mesh, Tool* tool) {
  int address = m->mesh_graphadr[mesh];
  if (address < 0) return -1;
  const int* graph = m->mesh_graph + address;
  int nvert = graph[0], nface = graph[1];
  const int* face = graph + 2 + 2 * nvert + (nvert + 3 * nface);
  const int* hull_vertex = graph + 2 + nvert;
  const float* vert = m->mesh_vert + 3 * m->mesh_vertadr[mesh];
  double middle[3] = {0, 0, 0};
  for (int i = 0; i < nvert; i++)
    for (int k = 0; k < 3; k++) middle[k] += vert[3 * hull_vertex[i] + k] / (double)nvert;
  tool->plane = malloc(sizeof(double) * 4 * (size_t)nface);
  if (!tool->plane) return -1;
  tool->nplane = 0;
  for (int f = 0; f < nface; f++) {
    double corner[3][3], u[3], v[3], n[3], inner[3];
    for (int c = 0; c < 3; c++)
      for (int k = 0; k < 3; k++) corner[c][k] = vert[3 * face[3 * f + c] + k];
    for (int k = 0; k < 3; k++) {
      u[k] = corner[1][k] - corner[0][k];
      v[k] = corner[2][k] - corner[0][k];
      inner[k] = middle[k] - corner[0][k];
    }
    cross(n, u, v);
    double length = sqrt(dot(n, n));
    if (length < 1e-14) continue;
    double sign = dot(n, inner) > 0 ? -1 / length : 1 / length;
    double* row = tool->plane + 4 * tool->nplane;
    for (int k = 0; k < 3; k++) row[k] = n[k] * sign;
    row[3] = dot(row, corner[0]);
    // The triangles of one flat face give one half-space.
    int known = 0;
    for (int p = 0; p < tool->nplane && !known; p++) {
      const double* other = tool->plane + 4 * p;
      known = dot(row, other) > 1 - 1e-9 && fabs(row[3] - other[3]) < 1e-7;
    }
    tool->nplane += !known;
  }
  return tool->nplane < 4 ? -1 : 0;
}

int tool_init(const mjModel* m, int geom, Tool* tool) {
  memset(tool, 0, sizeof *tool);
  tool->geom = geom;
  tool->body = m->geom_bodyid[geom];
  tool->type = m->geom_type[geom];
  memcpy(tool->size, m->geom_size + 3 * geom, sizeof tool->size);
  memcpy(tool->box, m->geom_aabb + 6 * geom, sizeof tool->box);
  tool->bound = m->geom_rbound[geom];
  tool->give = m->nuser_geom ? m->geom_user[geom * m->nuser_geom] : 0;
  tool->faced = tool->type == mjGEOM_BOX || tool->type == mjGEOM_CYLINDER || tool->type == mjGEOM_MESH;
  switch (tool->type) {
    case mjGEOM_SPHERE:
      tool->size[1] = tool->size[2] = tool->size[0];
      return 0;
    case mjGEOM_ELLIPSOID:
    case mjGEOM_CAPSULE:
    case mjGEOM_CYLINDER:
    case mjGEOM_BOX:
      return 0;
    case mjGEOM_MESH:
      return hull_planes(m, m->geom_dataid[geom], tool);
    default:
      return -1;
  }
}

void tool_free(Tool* tool) {
  free(tool->plane);
  tool->plane = NULL;
}

void tool_place(const mjModel* m, const mjData* d, int bone, double dt, Tool* tool) {
  const double *R = d->xmat + 9 * bone, *at = d->xpos + 3 * bone, *place = d->geom_xpos + 3 * tool->geom;
  const double* axes = d->geom_xmat + 9 * tool->geom;
  double arm[3], carried[3], of_bone[6], of_tool[6], shift[3], turn[3];
  mj_objectVelocity(m, d, mjOBJ_XBODY, bone, of_bone, 0);
  mj_objectVelocity(m, d, mjOBJ_GEOM, tool->geom, of_tool, 0);
  for (int k = 0; k < 3; k++) arm[k] = place[k] - at[k];
  cross(carried, of_bone, arm);
  for (int k = 0; k < 3; k++) {
    shift[k] = dt * (of_tool[3 + k] - of_bone[3 + k] - carried[k]);
    turn[k] = dt * (of_tool[k] - of_bone[k]);
  }
  rotate_back(tool->centre, R, arm);
  rotate_back(tool->shift, R, shift);
  rotate_back(tool->turn, R, turn);
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++)
      tool->axes[3 * i + j] = R[i] * axes[j] + R[3 + i] * axes[3 + j] + R[6 + i] * axes[6 + j];
}

void tool_shift(const Tool* tool, const double point[3], double out[3]) {
  double arm[3] = {point[0] - tool->centre[0], point[1] - tool->centre[1], point[2] - tool->centre[2]};
  cross(out, tool->turn, arm);
  for (int k = 0; k < 3; k++) out[k] += tool->shift[k];
}

static void to_local(const Tool* tool, const double point[3], double out[3]) {
  double away[3] = {point[0] - tool->centre[0], point[1] - tool->centre[1], point[2] - tool->centre[2]};
  rotate_back(out, tool->axes, away);
}

double tool_distance(const Tool* tool, const double point[3]) {
  double x[3], away = 0;
  to_local(tool, point, x);
  switch (tool->type) {
    case mjGEOM_SPHERE:
    case mjGEOM_ELLIPSOID: {
      // The value of the ellipsoid's function over the size of its gradient: exact for a sphere, near for the rest.
      double value = 0, gradient = 0;
      for (int k = 0; k < 3; k++) {
        double y = x[k] / tool->size[k];
        value += y * y;
        gradient += y * y / (tool->size[k] * tool->size[k]);
      }
      return gradient > PARALLEL ? sqrt(value) * (sqrt(value) - 1) / sqrt(gradient) : -tool->bound;
    }
    case mjGEOM_CAPSULE:
      x[2] -= most(-tool->size[1], least(tool->size[1], x[2]));
      return sqrt(dot(x, x)) - tool->size[0];
    default:
      for (int k = 0; k < 3; k++) {
        double over = most(0, fabs(x[k] - tool->box[k]) - tool->box[3 + k]);
        away += over * over;
      }
      return sqrt(away);
  }
}

// Roots of |x + s v|^2 = r^2; 0 when there are none.
static int roots(double vv, double xv, double xx_rr, double* first, double* second) {
  double inside = xv * xv - vv * xx_rr;
  if (inside <= 0 || vv < PARALLEL) return 0;
  double root = sqrt(inside);
  *first = (-xv - root) / vv;
  *second = (-xv + root) / vv;
  return 1;
}

static int exit_ellipsoid(const double size[3], const double x[3], const double v[3], double* enters, double* leaves,
                          double normal[3]) {
  double y[3], u[3];
  for (int k = 0; k < 3; k++) {
    y[k] = x[k] / size[k];
    u[k] = v[k] / size[k];
  }
  if (!roots(dot(u, u), dot(y, u), dot(y, y) - 1, enters, leaves)) return 0;
  for (int k = 0; k < 3; k++) normal[k] = (y[k] + *leaves * u[k]) / size[k];
  double length = sqrt(dot(normal, normal));
  for (int k = 0; k < 3; k++) normal[k] /= length;
  return 1;
}

// A cylinder's wall between its end planes, and for a capsule the two spheres at its ends.
static int exit_round(const double size[3], int capsule, const double x[3], const double v[3], double* enters,
                      double* leaves, double normal[3]) {
  double radius = size[0], half = size[1], near = mjMAXVAL, far = -mjMAXVAL, a, b;
  if (roots(v[0] * v[0] + v[1] * v[1], x[0] * v[0] + x[1] * v[1], x[0] * x[0] + x[1] * x[1] - radius * radius, &a, &b)) {
    if (fabs(x[2] + a * v[2]) <= half) near = a;
    if (fabs(x[2] + b * v[2]) <= half) {
      far = b;
      normal[0] = (x[0] + b * v[0]) / radius;
      normal[1] = (x[1] + b * v[1]) / radius;
      normal[2] = 0;
    }
  }
  for (int side = -1; side <= 1; side += 2) {
    if (capsule) {
      double y[3] = {x[0], x[1], x[2] - side * half};
      if (!roots(dot(v, v), dot(y, v), dot(y, y) - radius * radius, &a, &b)) continue;
      near = least(near, a);
      if (b > far) {
        far = b;
        for (int k = 0; k < 3; k++) normal[k] = (y[k] + b * v[k]) / radius;
      }
    } else if (fabs(v[2]) > PARALLEL) {
      double s = (side * half - x[2]) / v[2], p = x[0] + s * v[0], q = x[1] + s * v[1];
      if (p * p + q * q > radius * radius) continue;
      near = least(near, s);
      if (s > far) {
        far = s;
        normal[0] = normal[1] = 0;
        normal[2] = side;
      }
    }
  }
  *enters = near;
  *leaves = far;
  return far > -mjMAXVAL;
}

// One half-space n . x <= o narrows the stretch of the ray that is inside; 0 when nothing is left.
static int narrow(const double n[3], double o, const double x[3], const double v[3], double* enters, double* leaves,
                  double normal[3]) {
  double towards = dot(n, v), room = o - dot(n, x);
  if (fabs(towards) < PARALLEL) return room >= 0;
  double s = room / towards;
  if (towards > 0) {
    if (s < *leaves) {
      *leaves = s;
      memcpy(normal, n, 3 * sizeof(double));
    }
  } else if (s > *enters) {
    *enters = s;
  }
  return *enters < *leaves;
}

// How far a point lies outside a box or cylinder whose edges are rounded with the radius `edge`, and the gradient of this
// distance. q is how far the point lies past each face, if the faces are drawn in by `edge`. Convex, and exact outside.
static double outside_rounded(const double q[3], double edge, double toward[3]) {
  double out = 0, farthest = -mjMAXVAL;
  int nearest = 0;
  for (int k = 0; k < 3; k++) {
    if (q[k] > 0) out += q[k] * q[k];
    if (q[k] > farthest) {
      farthest = q[k];
      nearest = k;
    }
  }
  out = sqrt(out);
  for (int k = 0; k < 3; k++) toward[k] = farthest > 0 ? most(0, q[k]) / out : k == nearest;
  return (farthest > 0 ? out : farthest) - edge;
}

static double rim_of_box(const double size[3]) { return least(EDGE, least(size[0], least(size[1], size[2]))); }
static double rim_of_cylinder(const double size[3]) { return least(EDGE, least(size[0], size[1])); }

static double outside_box(const double size[3], const double x[3], double gradient[3]) {
  double edge = rim_of_box(size), q[3];
  for (int k = 0; k < 3; k++) q[k] = fabs(x[k]) - size[k] + edge;
  double away = outside_rounded(q, edge, gradient);
  for (int k = 0; k < 3; k++) gradient[k] = x[k] < 0 ? -gradient[k] : gradient[k];
  return away;
}

static double outside_cylinder(const double size[3], const double x[3], double gradient[3]) {
  double edge = rim_of_cylinder(size), round = sqrt(x[0] * x[0] + x[1] * x[1]), toward[3];
  double q[3] = {round - size[0] + edge, fabs(x[2]) - size[1] + edge, -mjMAXVAL};
  double away = outside_rounded(q, edge, toward);
  gradient[0] = round > 0 ? toward[0] * x[0] / round : 0;
  gradient[1] = round > 0 ? toward[0] * x[1] / round : 0;
  gradient[2] = x[2] < 0 ? -toward[1] : toward[1];
  return away;
}

// How far x lies outside the softened hull of a mesh, and the gradient: softness times the logarithm of the sum of
// exponentials of the half-spaces' distances over softness. Convex.
static double outside_hull(const Tool* tool, const double x[3], double gradient[3]) {
  double farthest = -mjMAXVAL, sum = 0;
  for (int k = 0; k < tool->nplane; k++) farthest = most(farthest, dot(tool->plane + 4 * k, x) - tool->plane[4 * k + 3]);
  gradient[0] = gradient[1] = gradient[2] = 0;
  for (int k = 0; k < tool->nplane; k++) {
    const double* plane = tool->plane + 4 * k;
    double below = dot(plane, x) - plane[3] - farthest;
    if (below < -20 * SOFTNESS) continue;
    double share = exp(below / SOFTNESS);
    sum += share;
    for (int j = 0; j < 3; j++) gradient[j] += share * plane[j];
  }
  for (int j = 0; j < 3; j++) gradient[j] /= sum;
  return farthest + SOFTNESS * log(sum);
}

// How far x lies outside an ellipsoid, or less: exact for a sphere.
static double outside_ellipsoid(const double size[3], const double x[3], double gradient[3]) {
  double value = 0, least_size = least(size[0], least(size[1], size[2]));
  for (int k = 0; k < 3; k++) value += x[k] * x[k] / (size[k] * size[k]);
  value = sqrt(value);
  for (int k = 0; k < 3; k++) gradient[k] = value > 0 ? least_size * x[k] / (size[k] * size[k] * value) : k == 2;
  return least_size * (value - 1);
}

static double outside_capsule(const double size[3], const double x[3], double gradient[3]) {
  double y[3] = {x[0], x[1], x[2] - most(-size[1], least(size[1], x[2]))}, away = sqrt(dot(y, y));
  for (int k = 0; k < 3; k++) gradient[k] = away > 0 ? y[k] / away : k == 0;
  return away - size[0];
}

// A convex function that is 0 on the surface, below 0 inside and outside at most the distance, and its gradient.
static double outside(const Tool* tool, const double x[3], double gradient[3]) {
  switch (tool->type) {
    case mjGEOM_SPHERE:
    case mjGEOM_ELLIPSOID:
      return outside_ellipsoid(tool->size, x, gradient);
    case mjGEOM_CAPSULE:
      return outside_capsule(tool->size, x, gradient);
    case mjGEOM_BOX:
      return outside_box(tool->size, x, gradient);
    case mjGEOM_CYLINDER:
      return outside_cylinder(tool->size, x, gradient);
    default:
      return outside_hull(tool, x, gradient);
  }
}

// From where the ray leaves the sharp shape back to where it leaves the rounded one, which lies inside: Newton's method
// on a convex function from its outer side. 0 when the ray only passes the rounding.
static int round_exit(const Tool* tool, const double x[3], const double v[3], double enters, double* leaves,
                      double normal[3]) {
  for (int k = 0; k < NEWTON_STEPS; k++) {
    double y[3], gradient[3];
    for (int j = 0; j < 3; j++) y[j] = x[j] + *leaves * v[j];
    double away = outside(tool, y, gradient), slope = dot(gradient, v);
    if (away < 1e-9) {
      double length = sqrt(dot(gradient, gradient));
      for (int j = 0; j < 3; j++) normal[j] = gradient[j] / length;
      return slope > 0;
    }
    if (slope < PARALLEL) return 0;
    *leaves -= away / slope;
    if (*leaves < enters) return 0;
  }
  return 0;
}

// Where the ray from x along v, which is a unit vector, leaves the tool: the distances at which it enters and leaves, both
// signed, and the outward normal there; 0 on a miss.
static int exit_of(const Tool* tool, const double x[3], const double v[3], double* enters, double* leaves, double n[3]) {
  int hit = 1;
  *enters = -mjMAXVAL;
  *leaves = mjMAXVAL;
  switch (tool->type) {
    case mjGEOM_SPHERE:
    case mjGEOM_ELLIPSOID:
      hit = exit_ellipsoid(tool->size, x, v, enters, leaves, n);
      break;
    case mjGEOM_CAPSULE:
    case mjGEOM_CYLINDER:
      hit = exit_round(tool->size, tool->type == mjGEOM_CAPSULE, x, v, enters, leaves, n);
      if (tool->type == mjGEOM_CYLINDER) hit = hit && round_exit(tool, x, v, *enters, leaves, n);
      break;
    case mjGEOM_BOX:
      for (int k = 0; k < 6 && hit; k++) {
        double face[3] = {0, 0, 0};
        face[k / 2] = k % 2 ? 1 : -1;
        hit = narrow(face, tool->size[k / 2], x, v, enters, leaves, n);
      }
      hit = hit && round_exit(tool, x, v, *enters, leaves, n);
      break;
    default:
      for (int k = 0; k < tool->nplane && hit; k++)
        hit = narrow(tool->plane + 4 * k, tool->plane[4 * k + 3], x, v, enters, leaves, n);
      hit = hit && round_exit(tool, x, v, *enters, leaves, n);
  }
  return hit;
}

// The foot of x on the surface, found by walking from a place y near it: onto the surface, and along its tangent plane to
// under x. Returns 0 where the walk does not end because x lies deeper than the surface is round.
static int foot(const Tool* tool, const double x[3], double y[3], double* gap, double normal[3]) {
  for (int k = 0; k < FOOT_STEPS; k++) {
    double gradient[3], away[3], value = outside(tool, y, gradient), size = sqrt(dot(gradient, gradient));
    for (int j = 0; j < 3; j++) {
      normal[j] = gradient[j] / size;
      y[j] -= value / size * normal[j];
      away[j] = x[j] - y[j];
    }
    *gap = dot(away, normal);
    double beside = 0;
    for (int j = 0; j < 3; j++) {
      double step = away[j] - *gap * normal[j];
      y[j] += step;
      beside += step * step;
    }
    if (beside < FOOT_NEAR * FOOT_NEAR) return 1;
  }
  return 0;
}

// Whether `outside` is the distance at a point inside: not of ellipsoids and hulls, nor deeper than the rounding of rims.
static int is_distance(const Tool* tool, double value) {
  switch (tool->type) {
    case mjGEOM_SPHERE:
    case mjGEOM_CAPSULE:
      return 1;
    case mjGEOM_BOX:
      return value > -rim_of_box(tool->size);
    case mjGEOM_CYLINDER:
      return value > -rim_of_cylinder(tool->size);
    default:
      return 0;
  }
}

int tool_gap(const Tool* tool, const double point[3], const double direction[3], double farthest, double* begins,
             double* gap, double normal[3]) {
  double x[3], v[3], y[3], n[3] = {0, 0, 0}, gradient[3], leaves = 0;
  to_local(tool, point, x);
  rotate_back(v, tool->axes, direction);
  *begins = 0;
  double value = outside(tool, x, gradient), found;
  if (value > farthest) return 0;
  if (value < 0 && !exit_of(tool, x, v, begins, &leaves, n)) return 0;
  int exact = 1;
  *gap = -leaves * dot(n, v);
  // Deep inside, the nearest wall can be another than the one that the point has met.
  if (value < 0 && is_distance(tool, value) && (value > -EDGE || dot(gradient, n) > SAME_WALL)) {
    *gap = value;
    memcpy(n, gradient, sizeof n);
  } else {
    double m[3];
    for (int k = 0; k < 3; k++) y[k] = x[k] + leaves * v[k];
    if (foot(tool, x, y, &found, m)) {
      *gap = found;
      memcpy(n, m, sizeof n);
    } else if (value >= 0) {
      return 0;
    } else {
      exact = 0;
    }
  }
  rotate(normal, tool->axes, n);
  return exact ? 1 : 2;
}

int tool_below(const Tool* tool, const double point[3], const double direction[3], double* begins, double* gap,
               double normal[3]) {
  double x[3], v[3], n[3] = {0, 0, 0}, leaves;
  to_local(tool, point, x);
  rotate_back(v, tool->axes, direction);
  if (!exit_of(tool, x, v, begins, &leaves, n) || leaves <= 0) return 0;
  *gap = -leaves * dot(n, v);
  rotate(normal, tool->axes, n);
  return 1;
}

// Curvature along e times its square, around the axis of a surface of revolution (Meusnier): 1 over the radius there,
// times how far the normal leans from the axis.
static double bend_round(const double y[3], const double n[3], const double e[3]) {
  double lean = sqrt(n[0] * n[0] + n[1] * n[1]), radius = sqrt(y[0] * y[0] + y[1] * y[1]);
  double around = n[0] * e[1] - n[1] * e[0];
  return lean * radius > PARALLEL ? around * around / (lean * radius) : 0;
}

double tool_bend(const Tool* tool, const double at[3], const double normal[3], const double offset[3]) {
  if (tool->type == mjGEOM_BOX || tool->type == mjGEOM_MESH) return 0;
  double y[3], n[3], e[3], steep = 0, bend = 0;
  to_local(tool, at, y);
  rotate_back(n, tool->axes, normal);
  rotate_back(e, tool->axes, offset);
  double along = dot(e, n);
  for (int k = 0; k < 3; k++) e[k] -= along * n[k];
  double square = dot(e, e);
  switch (tool->type) {
    case mjGEOM_SPHERE:
    case mjGEOM_ELLIPSOID:
      for (int k = 0; k < 3; k++) {
        double inverse = 1 / (tool->size[k] * tool->size[k]);
        steep += y[k] * y[k] * inverse * inverse;
        bend += e[k] * e[k] * inverse;
      }
      bend /= sqrt(steep);
      break;
    case mjGEOM_CAPSULE:
      bend = fabs(y[2]) > tool->size[1] ? square / tool->size[0] : bend_round(y, n, e);
      break;
    case mjGEOM_CYLINDER:
      bend = bend_round(y, n, e);
      break;
  }
  // Of a tool that is smaller than the triangle, no more than its slope can be told.
  return least(bend, sqrt(square)) / 2;
}

double tool_round(const Tool* tool, const double point[3], double normal[3], double* bend) {
  double x[3], n[3], inverse[3], sum = 0, along = 0;
  to_local(tool, point, x);
  double value = outside(tool, x, n), size = sqrt(dot(n, n));
  for (int k = 0; k < 3; k++) n[k] /= size;
  rotate(normal, tool->axes, n);
  if (tool->type == mjGEOM_CAPSULE) {
    *bend = (fabs(x[2]) > tool->size[1] ? 2 : 1) / tool->size[0];
    return value;
  }
  // The ellipsoid of the tool's shape through the point is the tool's own, some factor larger or smaller. `steep` contains
  // this factor, so that `bend` is the sum of the curvatures of the tool's own surface between its centre and the point.
  for (int k = 0; k < 3; k++) {
    inverse[k] = 1 / (tool->size[k] * tool->size[k]);
    sum += inverse[k];
    along += inverse[k] * n[k] * n[k];
  }
  double steep = size / least(tool->size[0], least(tool->size[1], tool->size[2]));
  *bend = (sum - along) / steep;
  return value / size;
}

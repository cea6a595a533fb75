// How much of each triangle round tools touch. It is recorded, and moves nothing.
//
// Contact is solved in the middles of triangles, and the rim of a small tool's contact runs between them. Past the rim, a
// smooth skin leaves the tool without a corner, and the gap between both grows with the distance s from the rim as
//     g(s) = curvature / 2 ((s + layer)^2 - layer^2),   curvature = p / G + 2 H,   layer^2 = G / k_c:
// there the coupling G times the Laplacian of the indentation balances the anchors' pressure p (Pasternak's foundation),
// the tool bends away with twice its mean curvature H, and the layer of stiffness k_c spreads the end of the contact over
// a length of its own. So the gap at a corner past the rim tells how far away the rim is.
#include <math.h>
#include <string.h>

#include "region.h"
#include "vec.h"

enum { ROUNDS = 3, SIDES = 6 };

// The rim is an arc, and the line that touches it beside a corner lies outside of it by t^2 / (2 radius) at t along the
// line. Over one side of an equilateral triangle, whose square is 2.31 times the area, the mean is area over 10 radii.
static const double ARC = 0.1;
// A triangle's middle is a chord of the tool: it stands off by half the mean curvature times the square of the way to the
// corners, which is 0.77 times the area. Where triangles touch, a corner can stand off as much without being past the rim.
static const double CHORD = 0.77 / 4;
static const double UPRIGHT = 0.1;  // square of the cosine up to which a rim lies on a slope and not on a wall

// What a vertex past the rim knows of the place where it is.
typedef struct {
  double gap, spread;   // to the tool [m]; anchors' pressure over coupling [1/m]
  double length;        // over which the indentation falls [m]
  double bend, lean;    // sum of the tool's curvatures [1/m]; sine of the angle between its normal and the skin's
  double layer;         // [m]
} Past;

// The radius of the rim, if it lies so far from the vertex.
static double radius_of_rim(const Past* p, double far) { return 2 * p->lean / p->bend - far; }

static double distance_to_rim(const Past* p) {
  double far = 0;
  for (int k = 0; k < ROUNDS; k++) {
    // From the rim on the indentation falls as exp(-s / length), and with it the pressure and the slope around the tool.
    double x = least(far / p->length, 2), radius = most(radius_of_rim(p, far), far);
    double spread = p->spread * (1 + x * (2. / 3 + x / 4)), around = radius > 0 ? 1 / (1 + (x + far / radius) / 3) : 1;
    // The skin lies against the tool's slope at the rim.
    double lean = most(0, p->lean - far * p->bend / 2), upright = most(UPRIGHT, 1 - lean * lean);
    double curvature = sqrt(upright) * spread + p->bend * (1 + around) / (2 * upright);
    far = sqrt(p->layer * p->layer + 2 * p->gap / curvature) - p->layer;
  }
  return far;
}

// The contact by which a vertex knows the tool, and how many of its triangles touch.
static const Contact* met_by(const Region* r, int i, int* met) {
  const Contact* by = NULL;
  *met = 0;
  for (int k = r->vertex[i].use; k < r->vertex[i].use + r->live[i]; k++) {
    const Contact* c = r->contact + r->live_contact[k];
    if (r->point[c->point].third) continue;
    if (c->touching || !by) by = c;
    *met += c->touching;
  }
  return by;
}

// Where the rim is, seen from a vertex. A vertex half of whose triangles touch is not past it, even if it stands off.
static void find_rim(const Region* r, const Law* law, int i) {
  const Vertex* v = r->vertex + i;
  const double *u = r->u + 3 * i, *inward = v->frame;
  Rim* rim = r->rim + i;
  const Contact* by = met_by(r, i, &rim->met);
  rim->known = 1;
  rim->past = 0;
  if (2 * POINTS_EACH * rim->met >= v->uses) return;
  double at[3], normal[3], area = r->point[by->point].area;
  Past p = {.length = sqrt(law->coupling / law_tangent(law, u[0])), .layer = sqrt(law->coupling / by->stiff)};
  rotate_back(at, v->frame, u);
  for (int k = 0; k < 3; k++) at[k] += v->place[k];
  p.gap = tool_round(r->tool + by->tool, at, normal, &p.bend);
  double along = dot(normal, inward);
  for (int k = 0; k < 3; k++) rim->toward[k] = normal[k] - along * inward[k];
  p.lean = sqrt(dot(rim->toward, rim->toward));
  if (p.gap <= 0 || p.lean == 0 || (rim->met >= 2 && p.gap < CHORD * p.bend * area)) return;
  double pressure = law_pressure(law, u[0]) + law_damping(law, u[0]) * r->rate[3 * i];
  p.spread = most(0, pressure) / law->coupling;
  rim->past = 1;
  rim->far = distance_to_rim(&p);
  rim->far += ARC * area / most(radius_of_rim(&p, rim->far), sqrt(area));
  for (int k = 0; k < 3; k++) rim->toward[k] /= p.lean;
}

// Cuts off the part of a polygon of n corners where f = f0 + f1 x + f2 y is above 0; returns how many corners are left.
static int cut(double polygon[SIDES][2], int n, const double f[3]) {
  double whole[SIDES][2];
  int left = 0;
  memcpy(whole, polygon, sizeof whole);
  for (int k = 0; k < n; k++) {
    const double *a = whole[k], *b = whole[(k + 1) % n];
    double fa = f[0] + f[1] * a[0] + f[2] * a[1], fb = f[0] + f[1] * b[0] + f[2] * b[1];
    if (fa <= 0) memcpy(polygon[left++], a, sizeof *polygon);
    if ((fa <= 0) == (fb <= 0)) continue;
    for (int j = 0; j < 2; j++) polygon[left][j] = a[j] + (b[j] - a[j]) * fa / (fa - fb);
    left++;
  }
  return left;
}

// The share of a triangle on this side of the rims that its corners see. The polygon's coordinates are the shares of the
// second and the third corner.
static double share_within(const Region* r, const Contact* c) {
  const Point* p = r->point + c->point;
  double polygon[SIDES][2] = {{0, 0}, {1, 0}, {0, 1}}, twice = 0;
  int n = 3;
  for (int k = 0; k < 3; k++) {
    const Rim* rim = r->rim + p->corner[k];
    double f[3];
    if (!rim->past) continue;
    for (int j = 0; j < 3; j++) f[j] = rim->far + dot(rim->toward, p->offset[j]) - dot(rim->toward, p->offset[k]);
    f[1] -= f[0];
    f[2] -= f[0];
    n = cut(polygon, n, f);
  }
  for (int k = 0; k < n; k++) {
    const double *a = polygon[k], *b = polygon[(k + 1) % n];
    twice += a[0] * b[1] - b[0] * a[1];
  }
  return most(0, twice);
}

// Looks for the rim from the corners of a triangle; returns whether a triangle at one of them touches.
static int corners_meet(Region* r, const Law* law, const Contact* c) {
  int met = 0;
  for (int k = 0; k < 3; k++) {
    int corner = r->point[c->point].corner[k];
    if (!r->rim[corner].known) find_rim(r, law, corner);
    met |= r->rim[corner].met > 0;
  }
  return met;
}

void rim_find(Region* r, const Law* law) {
  for (int i = 0; i < r->ncontact; i++)
    for (int k = 0; k < 3; k++) r->rim[r->point[r->contact[i].point].corner[k]].known = 0;
  for (int i = 0; i < r->ncontact; i++) {
    Contact* c = r->contact + i;
    c->touched = c->touching ? c->area : 0;
    // Skin without coupling leaves a tool with a corner.
    if (!r->point[c->point].third && c->area > 0 && law->coupling > 0 && corners_meet(r, law, c))
      c->touched = c->area * share_within(r, c);
    r->row[ROW_AREA] += c->touched;
  }
}

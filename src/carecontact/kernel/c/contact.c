// The contact points near a tool: how deep each lies in it, and what friction it carries over from the step before.
#include <math.h>
#include <string.h>

#include "region.h"
#include "vec.h"

static const double NEAR_GAP = 0.001;  // [m] a point farther outside cannot come to touch within a step
// Cosine between a point's normal and the tool's: at the first it does not touch, from the second on fully. Between
// them the contact layer grows softer, so that a wall that passes a point does not let it go at once.
static const double STEEPEST = 0.05, STEEP = 0.30;

static double grip(double lean) {
  double x = (lean - STEEPEST) / (STEEP - STEEPEST);
  return x >= 1 ? 1 : x * x * (3 - 2 * x);
}

static void place_of(const Region* r, const State* s, const Point* p, double out[3]) {
  out[0] = out[1] = out[2] = 0;
  for (int c = 0; c < p->corners; c++) {
    const Vertex* v = r->vertex + p->corner[c];
    const double* u = s->u + 3 * p->corner[c];
    for (int k = 0; k < 3; k++)
      out[k] += p->share[c] * (v->place[k] + u[0] * v->frame[k] + u[1] * v->frame[3 + k] + u[2] * v->frame[6 + k]);
  }
}

// The gap to the tool that the point lies deepest in, measured along the ray inward from the point to where it leaves
// the tool, and from there across to the tool's tangent plane. Returns the tool's number, or -1.
static int deepest_tool(const Region* r, const Point* p, const double at[3], double thickness, double* gap,
                        double normal[3]) {
  int best = -1;
  double farthest = -mjMAXVAL;
  for (int k = 0; k < r->ntool; k++) {
    double enters, leaves, n[3];
    if (!r->tool[k].near || !tool_exit(r->tool + k, at, p->inward, &enters, &leaves, n)) continue;
    double lean = dot(n, p->inward);
    // A tool that begins deeper than the tissue lies beyond the bone.
    if (enters > thickness || lean < STEEPEST || leaves < farthest) continue;
    farthest = leaves;
    best = k;
    *gap = -leaves * lean;
    memcpy(normal, n, 3 * sizeof(double));
  }
  return best;
}

void contact_find(Region* r, const State* s, const Law* law) {
  for (int i = 0; i < r->ncontact; i++) r->contact_of[r->contact[i].point] = -1;
  r->ncontact = 0;
  for (int q = 0; q < r->npoint; q++) {
    const Point* p = r->point + q;
    if (r->moves[p->corner[0]] != CLOSE) continue;
    Contact c = {.point = q};
    place_of(r, s, p, c.at);
    c.tool = deepest_tool(r, p, c.at, law->thickness, &c.gap, c.normal);
    if (c.tool < 0 || c.gap > NEAR_GAP) continue;
    c.stiff = law->contact * grip(dot(c.normal, p->inward));
    tool_shift(r->tool + c.tool, c.at, c.shift);
    const double* before = s->traction + 3 * q;
    double along = dot(before, c.normal);
    for (int k = 0; k < 3; k++) c.held[k] = before[k] - along * c.normal[k];
    for (int k = 0; k < p->corners; k++) rotate(c.local[k], r->vertex[p->corner[k]].frame, c.normal);
    r->contact_of[q] = r->ncontact;
    r->contact[r->ncontact++] = c;
  }
}

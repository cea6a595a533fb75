// Skin that a tool meets from the side is let in.
#include <math.h>
#include <string.h>

#include "region.h"
#include "vec.h"

static const double SLACK = 1e-5;   // [m] of a gap that is a distance
static const double BENDS = 0.25;   // how much of its motion a distance may change beyond what its normal tells

void entry_allow(const Law* law, Contact* c, int exact) {
  double away[3], along = 0, size = 0, depth = -(c->gap + dot(c->normal, c->seen));
  for (int k = 0; k < 3; k++) {
    away[k] = c->shift[k] - c->seen[k];
    along += away[k] * c->normal[k];
    size += away[k] * away[k];
  }
  size = sqrt(size);
  double slack = exact ? SLACK + BENDS * size : 0;
  c->allowed = 0;
  if (c->stayed) {
    double more = depth - (c->depth_before + c->allowed_before + along);
    c->allowed = c->allowed_before + (fabs(more) > slack ? more : 0);
  } else if (depth > 0) {
    c->allowed = most(0, depth - most(0, along) - slack);
  }
  memset(c->ramp, 0, sizeof c->ramp);
  if (c->allowed == 0) return;
  double far = 0;
  for (int k = 0; k < 3; k++) {
    c->ramp[k] = away[k] - along * c->normal[k];
    far += c->ramp[k] * c->ramp[k];
  }
  far = sqrt(far);
  double slope = far > 1e-9 ? c->allowed / (law->entry + far) / far : 0;
  for (int k = 0; k < 3; k++) {
    c->ramp[k] *= slope;
    c->push[k] += c->ramp[k];
  }
  c->gap += c->allowed - dot(c->ramp, c->shift);
}

double entry_left(const Contact* c) {
  double left = c->allowed;
  for (int k = 0; k < 3; k++) left += c->ramp[k] * (c->moved[k] - c->shift[k]);
  return left;
}

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
  memset(c->drag, 0, sizeof c->drag);
  if (c->allowed == 0) return;
  double far = 0, way[3], across = dot(c->shift, c->normal);
  for (int k = 0; k < 3; k++) {
    way[k] = c->shift[k] - across * c->normal[k];
    far += way[k] * way[k];
  }
  far = sqrt(far);
  if (far > 1e-9) {
    double left = c->allowed * law->entry / (law->entry + far), slope = (c->allowed - left) / far;
    for (int k = 0; k < 3; k++) c->drag[k] = slope * way[k] / far;
    c->allowed = left;
  }
  c->gap += c->allowed;
}

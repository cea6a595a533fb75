// Which vertices may move in a step: those within reach of a tool that touches, and those still on their way back.
#include <math.h>
#include <string.h>

#include "region.h"
#include "vec.h"

static const double NEARLY = 0.003;  // [m] a tool farther than this from every vertex touches none in this step

// Marks the vertices within reach of one tool, if it is near enough to touch.
static void look_around(Region* r, const State* s, Tool* tool, double reach) {
  double nearest = NEARLY, limit = tool->bound + reach;
  // Floats first: they tell the many vertices far away from the few whose distance is worth computing.
  float x = (float)tool->centre[0], y = (float)tool->centre[1], z = (float)tool->centre[2], square = (float)(limit * limit);
  for (int i = 0; i < r->nvertex; i++) {
    float a = r->px[i] - x, b = r->py[i] - y, c = r->pz[i] - z;
    r->hit[i] = a * a + b * b + c * c < square;
  }
  for (int i = 0; i < r->nvertex; i++) {
    if (!r->hit[i]) continue;
    const double *u = s->u + 3 * i, *frame = r->vertex[i].frame, *place = r->vertex[i].place;
    double now[3];
    for (int k = 0; k < 3; k++) now[k] = place[k] + u[0] * frame[k] + u[1] * frame[3 + k] + u[2] * frame[6 + k];
    double away = tool_distance(tool, now);
    nearest = least(nearest, away);
    r->hit[i] = away < NEARLY + r->vertex[i].span ? CLOSE : away < reach ? MOVES : AWAY;
  }
  tool->near = nearest < NEARLY;
  if (tool->near)
    for (int i = 0; i < r->nvertex; i++)
      if (r->hit[i] > r->moves[i]) r->moves[i] = r->hit[i];
}

void window_find(const mjModel* m, const mjData* d, Region* r, const State* s, double reach) {
  const double *R = d->xmat + 9 * r->bone, *bone = d->xpos + 3 * r->bone;
  memset(r->moves, 0, (size_t)r->nvertex);
  int near = 0;
  for (int k = 0; k < r->ntool; k++) {
    Tool* tool = r->tool + k;
    double away[3], middle[3], limit = r->bound + tool->bound + NEARLY;
    rotate(middle, R, r->middle);
    for (int j = 0; j < 3; j++) away[j] = d->geom_xpos[3 * tool->geom + j] - bone[j] - middle[j];
    tool->near = 0;
    if (dot(away, away) > limit * limit) continue;
    tool_place(m, d, r->bone, m->opt.timestep, tool);
    look_around(r, s, tool, reach);
    near |= tool->near;
  }
  r->nwindow = 0;
  if (!near && *s->awake == 0) return;
  for (int i = 0; i < r->nvertex; i++) {
    const double* u = s->u + 3 * i;
    int moving = u[0] != 0 || u[1] != 0 || u[2] != 0;
    if (moving && r->moves[i] == AWAY) r->moves[i] = MOVES;
    if (r->moves[i] != AWAY) r->window[r->nwindow++] = i;
  }
}

// Which vertices may move in a step: those within reach of a tool that touches, and those still on their way back.
#include <math.h>
#include <string.h>

#include "region.h"
#include "vec.h"

static const double NEARLY = 0.003;  // [m] a tool farther than this from every vertex touches none in this step

static const double PATCH = 0.015;   // [m] radius of a patch

void patches_make(Region* r) {
  int taken = 0;
  memset(r->moves, 0, (size_t)r->nvertex);
  for (int i = 0; i < r->nvertex; i++) {
    if (r->moves[i]) continue;
    Patch* p = r->patch + r->npatch++;
    memcpy(p->middle, r->vertex[i].place, sizeof p->middle);
    p->first = taken;
    for (int j = i; j < r->nvertex; j++) {
      const double* x = r->vertex[j].place;
      double away[3] = {x[0] - p->middle[0], x[1] - p->middle[1], x[2] - p->middle[2]}, far = sqrt(dot(away, away));
      if (r->moves[j] || far > PATCH) continue;
      r->moves[j] = 1;
      p->radius = most(p->radius, far);
      p->span = most(p->span, r->vertex[j].span);
      r->in_patch[taken++] = j;
    }
    p->count = taken - p->first;
  }
}

// No vertex of the patch is nearer to the tool than this; none has moved farther than `moved`.
static double patch_distance(const Patch* p, const Tool* tool, double moved) {
  // Of an ellipsoid the distance is not exact, so that it says nothing about points beside.
  if (tool->type == mjGEOM_ELLIPSOID) return -mjMAXVAL;
  return tool_distance(tool, p->middle) - p->radius - moved - 1e-6;
}

// Whether every vertex of a patch at this distance may move and none can touch, so that none has to be looked at.
static int all_move(const Patch* p, const Tool* tool, double away, double reach, double moved) {
  double wide = 2 * (p->radius + moved + 1e-6), centre[3];
  if (away < NEARLY + p->span || away + wide >= reach) return 0;
  for (int k = 0; k < 3; k++) centre[k] = p->middle[k] - tool->centre[k];
  return sqrt(dot(centre, centre)) + wide < tool->bound + reach;
}

// What the vertices of a patch do because of a tool; returns the distance of the nearest, or `nearest` if that is less.
static double look_at(Region* r, const State* s, const Tool* tool, const Patch* p, double reach, double nearest) {
  // Floats first: they tell the many vertices far away from the few whose distance is worth computing.
  double limit = tool->bound + reach;
  float x = (float)tool->centre[0], y = (float)tool->centre[1], z = (float)tool->centre[2], square = (float)(limit * limit);
  for (int k = p->first; k < p->first + p->count; k++) {
    int i = r->in_patch[k];
    float a = r->px[i] - x, b = r->py[i] - y, c = r->pz[i] - z;
    r->hit[i] = AWAY;
    if (a * a + b * b + c * c >= square) continue;
    const double *u = s->u + 3 * i, *frame = r->vertex[i].frame, *place = r->vertex[i].place;
    double now[3];
    for (int j = 0; j < 3; j++) now[j] = place[j] + u[0] * frame[j] + u[1] * frame[3 + j] + u[2] * frame[6 + j];
    double away = tool_distance(tool, now);
    nearest = least(nearest, away);
    r->hit[i] = away < NEARLY + r->vertex[i].span ? CLOSE : away < reach ? MOVES : AWAY;
  }
  return nearest;
}

// Marks the vertices within reach of one tool, if it is near enough to touch.
static void look_around(Region* r, const State* s, Tool* tool, double reach, double moved) {
  double nearest = NEARLY;
  for (int k = 0; k < r->npatch; k++)
    if (patch_distance(r->patch + k, tool, moved) < NEARLY)
      nearest = look_at(r, s, tool, r->patch + k, reach, nearest);
  tool->near = nearest < NEARLY;
  if (!tool->near) return;
  for (int k = 0; k < r->npatch; k++) {
    const Patch* p = r->patch + k;
    double away = patch_distance(p, tool, moved);
    if (away >= most(reach, NEARLY + p->span)) continue;
    int together = all_move(p, tool, away, reach, moved);
    if (away >= NEARLY && !together) look_at(r, s, tool, p, reach, nearest);
    for (int j = p->first; j < p->first + p->count; j++) {
      int i = r->in_patch[j], hit = together ? MOVES : r->hit[i];
      if (hit > r->moves[i]) r->moves[i] = (unsigned char)hit;
    }
  }
}

// How far a vertex has moved at most.
static double farthest_moved(const Region* r, const State* s) {
  double most_square = 0;
  if (*s->awake == 0) return 0;
  for (int i = 0; i < r->nvertex; i++) most_square = most(most_square, dot(s->u + 3 * i, s->u + 3 * i));
  return sqrt(most_square);
}

void window_find(const mjModel* m, const mjData* d, Region* r, const State* s, double reach) {
  const double *R = d->xmat + 9 * r->bone, *bone = d->xpos + 3 * r->bone;
  memset(r->moves, 0, (size_t)r->nvertex);
  double moved = farthest_moved(r, s);
  int near = 0;
  for (int k = 0; k < r->ntool; k++) {
    Tool* tool = r->tool + k;
    double away[3], middle[3], limit = r->bound + tool->bound + NEARLY;
    rotate(middle, R, r->middle);
    for (int j = 0; j < 3; j++) away[j] = d->geom_xpos[3 * tool->geom + j] - bone[j] - middle[j];
    tool->near = 0;
    if (dot(away, away) > limit * limit) continue;
    tool_place(m, d, r->bone, m->opt.timestep, tool);
    look_around(r, s, tool, reach, moved);
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

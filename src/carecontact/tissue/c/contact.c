// The contact points near a tool: how deep each lies in it, and what friction it carries over from the step before.
#include <math.h>
#include <string.h>

#include "region.h"
#include "vec.h"

static const double NEAR_GAP = 0.001;  // [m] a point farther outside cannot come to touch within a step
// Cosine between a point's inward direction and the tool's normal, from which on the tool can press it. Upright walls do
// not: a disc on springs that know nothing of each other would plough.
static const double STEEPEST = 0.05;
// Skin that the tool's face has pressed goes on bearing where it is pushed round the rim and up the wall, until the wall
// overhangs this much.
static const double OVERHANGS = -0.3;
// How far a middle stands off at first, over the tool's depth. Beside a mesh of 2.5 mm (ball of 10 and 20 mm, cap), the
// forces at 0.3 to 2 mm are nearest with this: with 1/8 they are 10 to 25 % too high, with 1/2 as much too low.
static const double ARRIVES = 0.25;
// [m] A tool whose surface gives way, such as the pile of a mitt, is compressed by so much where it has become twice as
// stiff. Assumed: about as thick as the pile is (3 to 5 mm).
static const double PILE = 0.004;
// [m] On the roundest rim, a point that ends this far from where its gap was measured is wrong by a tenth of a micrometre.
static const double REVIEW = 2e-5;

// Where a point is, and how far it will have moved at the end of the step if its vertices go on as in the step before.
static void place_of(const Region* r, const State* s, const Point* p, double dt, double at[3], double ahead[3]) {
  for (int k = 0; k < 3; k++) at[k] = ahead[k] = 0;
  for (int c = 0; c < 3; c++) {
    const Vertex* v = r->vertex + p->corner[c];
    double moved[3], moving[3];
    rotate_back(moved, v->frame, s->u + 3 * p->corner[c]);
    rotate_back(moving, v->frame, s->rate + 3 * p->corner[c]);
    for (int k = 0; k < 3; k++) {
      at[k] += p->share[c] * (v->place[k] + moved[k]);
      ahead[k] += p->share[c] * dt * moving[k];
    }
  }
}

// The gap to the tool that a point at a place lies deepest in, and that tool's normal. Returns its number, or -1.
static int deepest_tool(const Region* r, const Point* p, const double place[3], const Law* law, int stayed,
                        double* gap, double normal[3], int* exact) {
  double steepest = stayed ? OVERHANGS : STEEPEST;
  int best = -1;
  *gap = NEAR_GAP;
  for (int k = 0; k < r->ntool; k++) {
    double enters, found, n[3];
    if (!r->tool[k].near || r->tool[k].faced != p->third) continue;
    int kind = tool_gap(r->tool + k, place, p->inward, NEAR_GAP, &enters, &found, n);
    if (!kind) continue;
    // Where skin is let in, skin that has been pushed up to where the wall overhangs is met by the tool's underside.
    if (law->entry > 0 && stayed && dot(n, p->inward) < 0) {
      if (!tool_below(r->tool + k, place, p->inward, &enters, &found, n)) continue;
      kind = 2;
    }
    if (dot(n, p->inward) < steepest) continue;
    // A tool that begins deeper than the tissue lies beyond the bone.
    if (enters > law->thickness || found > *gap) continue;
    best = k;
    *exact = kind == 1;
    *gap = found;
    memcpy(normal, n, 3 * sizeof(double));
  }
  return best;
}

// How far the middle of a triangle stands off a tool. Of the smooth skin the triangle is a chord: its corners lie on a
// round tool where its middle does not. First touch finds them where they were, and they come to lie on it as it goes
// deeper.
static double standing_off(const Region* r, const Point* p, int tool, const double place[3], double gap,
                           const double normal[3]) {
  double foot[3], bend = 0, deep = -gap / dot(normal, p->inward);
  for (int k = 0; k < 3; k++) {
    foot[k] = place[k] - gap * normal[k];
    deep += p->inward[k] * (place[k] - p->place[k]);
  }
  if (deep <= 0) return 0;
  for (int k = 0; k < 3; k++) bend += p->share[k] * tool_bend(r->tool + tool, foot, normal, p->offset[k]);
  return least(bend, ARRIVES * deep);
}

// Measures the gap where the point has moved by `seen`, from which it is taken as linear. Returns 0 far from every tool.
static int measure(const Region* r, const Law* law, Contact* c) {
  const Point* p = r->point + c->point;
  double place[3], gap, normal[3];
  int exact = 1;
  for (int k = 0; k < 3; k++) place[k] = c->at[k] + c->seen[k];
  int tool = deepest_tool(r, p, place, law, c->stayed, &gap, normal, &exact);
  if (tool < 0) return 0;
  c->tool = tool;
  c->stands_off = standing_off(r, p, tool, place, gap, normal);
  gap += c->stands_off;
  memcpy(c->normal, normal, sizeof normal);
  c->gap = gap - dot(normal, c->seen);
  c->stiff = 1 / (1 / law->contact + r->tool[tool].give);
  c->layer = law->layer > 0 && r->tool[tool].give > 0 ? law->layer + PILE : law->layer;
  tool_shift(r->tool + tool, c->at, c->shift);
  double along = dot(c->before, normal);
  for (int k = 0; k < 3; k++) c->held[k] = c->before[k] - along * normal[k];
  if (law->entry > 0 && c->stayed) entry_turn(c);
  if (law->entry > 0) entry_allow(law, c, exact);
  for (int k = 0; k < 3; k++) rotate(c->local[k], r->vertex[p->corner[k]].frame, normal);
  return 1;
}

void contact_keep(Region* r, const Contact* c) {
  const Point* p = r->point + c->point;
  for (int k = 0; k < 3; k++) {
    int at = r->vertex[p->corner[k]].use + r->live[p->corner[k]]++;
    r->live_contact[at] = r->ncontact;
    r->live_corner[at] = k;
  }
  r->contact[r->ncontact++] = *c;
}

void contact_forget(Region* r) {
  for (int i = 0; i < r->ncontact; i++)
    for (int k = 0; k < 3; k++) r->live[r->point[r->contact[i].point].corner[k]] = 0;
  r->ncontact = 0;
}

static void find_one(Region* r, const State* s, const Law* law, double dt, int q) {
  Contact c = {.point = q, .area = r->point[q].area, .stayed = r->held_of[q] >= 0};
  if (c.stayed) {
    const double* row = s->held + r->held_size * r->held_of[q];
    memcpy(c.before, row + 1, sizeof c.before);
    if (r->held_size == HELD_LONG) {
      c.depth_before = row[4];
      c.allowed_before = row[5];
      memcpy(c.normal_before, row + 6, sizeof c.normal_before);
      memcpy(c.bristle_before, row + 9, sizeof c.bristle_before);
    }
  }
  place_of(r, s, r->point + q, dt, c.at, c.seen);
  if (!measure(r, law, &c)) return;
  contact_keep(r, &c);
}

// What the tool presses a point with where its gap was measured, as if the layer could pull too [Pa].
static double pressed(const Contact* c) { return -c->stiff * (c->gap + dot(c->normal, c->seen)); }

// Skin that lies in a round tool and in one with faces at once is not to bear twice. Each third of the triangle belongs to
// the one that presses it more, which of equally stiff ones is the one that it lies deeper in. So its pressure does not
// jump when it changes hands.
static void share_out(Region* r) {
  for (int i = 0, middle = -1; i < r->ncontact; i++) {
    Contact* c = r->contact + i;
    if (!r->point[c->point].third) {
      middle = i;
    } else if (middle >= 0 && c->point - r->contact[middle].point < POINTS_EACH) {
      Contact* round = r->contact + middle;
      if (pressed(c) > pressed(round)) round->area = most(0, round->area - c->area);
      else c->area = 0;
    }
  }
}

void contact_find(Region* r, const State* s, const Law* law, double dt) {
  int meets[2] = {0, 0};
  for (int k = 0; k < r->ntool; k++) meets[r->tool[k].faced] |= r->tool[k].near;
  for (int k = 0; k < (int)*s->holds; k++) r->held_of[(int)s->held[r->held_size * k]] = k;
  for (int t = 0; t < r->npoint / POINTS_EACH; t++) {
    if (r->moves[r->first_corner[t]] != CLOSE) continue;
    for (int q = POINTS_EACH * t; q < POINTS_EACH * (t + 1); q++)
      if (meets[r->point[q].third]) find_one(r, s, law, dt, q);
  }
  for (int k = 0; k < (int)*s->holds; k++) r->held_of[(int)s->held[r->held_size * k]] = -1;
  if (meets[0] && meets[1]) share_out(r);
}

int contact_review(Region* r, const Law* law) {
  int changed = 0;
  for (int i = 0; i < r->ncontact; i++) {
    Contact* c = r->contact + i;
    double off[3];
    for (int k = 0; k < 3; k++) off[k] = c->moved[k] - c->seen[k];
    if (!c->touching || dot(off, off) < REVIEW * REVIEW) continue;
    memcpy(c->seen, c->moved, sizeof c->seen);
    changed |= measure(r, law, c);
  }
  return changed;
}

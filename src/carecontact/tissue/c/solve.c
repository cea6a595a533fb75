// One implicit step of the shell: inertia, anchors with their dampers, coupling and membrane, contact and friction.
//
// Block Gauss-Seidel over the vertices of the window: each block is the three unknowns of a vertex, solved with the
// tangent of its own forces while its neighbours stand still. Contact is a stiff elastic layer at each point: its pressure
// is that of layer.h, and its friction sticks with the layer's stiffness k and slips at the friction coefficient times the
// pressure (Coulomb, by return mapping).
#include <math.h>
#include <string.h>

#include "layer.h"
#include "region.h"
#include "vec.h"

static const double LARGEST = 5e-4;  // [m] a vertex in contact moves no farther in one sweep

// Where a point leaves or enters contact, a full step can throw its neighbours to and fro: after so many sweeps a vertex
// in contact makes only part of each.
static const int PATIENCE = 12;
static const double CAUTION = 0.5;

// Pressure and friction of a contact for the displacements as they stand; returns the share of the friction layer's
// stiffness that is left: 1 where it sticks.
static double respond(const Law* law, Contact* c) {
  double slide[3], size = 0, gap = c->gap + dot(c->normal, c->moved);
  c->touching = gap < 0;
  c->slipped = 0;
  if (!c->touching) {
    c->pressure = c->traction[0] = c->traction[1] = c->traction[2] = 0;
    return 0;
  }
  c->pressure = layer_pressure(c->stiff, c->layer, -gap);
  for (int j = 0; j < 3; j++) slide[j] = c->moved[j] - c->shift[j];
  double along = dot(slide, c->normal);
  for (int j = 0; j < 3; j++) {
    c->traction[j] = c->held[j] - c->stiff * (slide[j] - along * c->normal[j]);
    size += c->traction[j] * c->traction[j];
  }
  size = sqrt(size);
  double limit = law->friction * c->pressure;
  if (size <= limit) return 1;
  for (int j = 0; j < 3; j++) c->traction[j] *= limit / size;
  c->slipped = (size - limit) / c->stiff;
  return limit / size;
}

// Solves the symmetric 3 x 3 system B x = g.
static void solve3(const double B[6], const double g[3], double x[3]) {
  double a = B[0], b = B[1], c = B[2], d = B[3], e = B[4], f = B[5];  // a b c / b d e / c e f
  double c0 = d * f - e * e, c1 = c * e - b * f, c2 = b * e - c * d, det = a * c0 + b * c1 + c * c2;
  x[0] = (c0 * g[0] + c1 * g[1] + c2 * g[2]) / det;
  x[1] = (c1 * g[0] + (a * f - c * c) * g[1] + (b * c - a * e) * g[2]) / det;
  x[2] = (c2 * g[0] + (b * c - a * e) * g[1] + (a * d - b * b) * g[2]) / det;
}

// Adds what the contacts of a vertex do: to the forces g and to the tangent B, both in the vertex's frame.
static int add_contacts(Region* r, const Law* law, int i, double g[3], double B[6]) {
  const Vertex* v = r->vertex + i;
  double sum[3] = {0, 0, 0}, turned[3];
  int any = 0;
  for (int k = v->use; k < v->use + r->live[i]; k++) {
    Contact* c = r->contact + r->live_contact[k];
    double sticks = respond(law, c);
    if (!c->touching) continue;
    any = 1;
    int corner = r->live_corner[k];
    const Point* p = r->point + c->point;
    double share = p->share[corner] * c->area, stiff = c->stiff * share * p->share[corner];
    const double* m = c->local[corner];
    double rest = stiff * (1 - sticks), own = stiff * sticks;
    if (c->layer > 0) rest = layer_tangent(stiff, c->layer, -(c->gap + dot(c->normal, c->moved))) - own;
    for (int j = 0; j < 3; j++) sum[j] += share * (c->pressure * c->normal[j] + c->traction[j]);
    B[0] += rest * m[0] * m[0] + own;
    B[1] += rest * m[0] * m[1];
    B[2] += rest * m[0] * m[2];
    B[3] += rest * m[1] * m[1] + own;
    B[4] += rest * m[1] * m[2];
    B[5] += rest * m[2] * m[2] + own;
  }
  if (any) {
    rotate(turned, v->frame, sum);
    for (int j = 0; j < 3; j++) g[j] += turned[j];
  }
  return any;
}

// Carries the contact points of a vertex along with it, by x in the vertex's frame.
static void carry(Region* r, int i, const double x[3]) {
  const Vertex* v = r->vertex + i;
  double moved[3];
  rotate_back(moved, v->frame, x);
  for (int k = v->use; k < v->use + r->live[i]; k++) {
    Contact* c = r->contact + r->live_contact[k];
    double share = r->point[c->point].share[r->live_corner[k]];
    for (int j = 0; j < 3; j++) c->moved[j] += share * moved[j];
  }
}

// What of a vertex's balance stays the same throughout the step.
static void prepare(Region* r, const State* s, const Law* law, int i, double dt) {
  const Vertex* v = r->vertex + i;
  const double *before = s->u + 3 * i, *rate = s->rate + 3 * i;
  double inertia = v->area * law->mass / (dt * dt), damper = v->area * law_damping(law, before[0]) / dt;
  Balance* b = r->balance + i;
  for (int j = 0; j < 3; j++) b->pull[j] = (inertia + damper) * before[j] + inertia * dt * rate[j];
  b->normal = inertia + damper + law->coupling * v->weight;
  b->tangential = inertia + damper + v->area * law->a + law->membrane * v->weight;
  b->over = 1 / b->tangential;
}

// Moves one vertex to where its forces balance; returns the largest change of its unknowns.
static double relax(Region* r, const Law* law, int i, double share) {
  const Vertex* v = r->vertex + i;
  const Balance* b = r->balance + i;
  double *u = r->u + 3 * i, around[3] = {0, 0, 0}, x[3];
  for (int k = v->edge; k < v->edge + v->edges; k++) {
    const double *w = r->u + 3 * r->neighbour[k], weight = r->neighbour_weight[k];
    for (int j = 0; j < 3; j++) around[j] += weight * w[j];
  }
  double stiff = b->normal + v->area * law_tangent(law, u[0]);
  double g[3] = {b->pull[0] + law->coupling * around[0] - b->normal * u[0] - v->area * law_pressure(law, u[0]),
                 b->pull[1] + law->membrane * around[1] - b->tangential * u[1],
                 b->pull[2] + law->membrane * around[2] - b->tangential * u[2]};
  double grows, firmer = v->area * law_firmer(law, u[0], &grows), across = b->tangential + firmer;
  if (firmer > 0) {
    g[0] -= v->area * grows * (u[1] * u[1] + u[2] * u[2]) / 2;
    g[1] -= firmer * u[1];
    g[2] -= firmer * u[2];
  }
  grows *= v->area;
  double B[6] = {stiff, grows * u[1], grows * u[2], across, 0, across};
  if (r->moves[i] == CLOSE && add_contacts(r, law, i, g, B)) {
    solve3(B, g, x);
    double size = most3(x), part = size > LARGEST ? LARGEST / size : share;
    for (int j = 0; j < 3; j++) x[j] *= part;
  } else {
    x[0] = g[0] / stiff;
    double over = firmer > 0 ? 1 / across : b->over;
    x[1] = g[1] * over;
    x[2] = g[2] * over;
  }
  for (int j = 0; j < 3; j++) u[j] += x[j];
  if (r->moves[i] == CLOSE) carry(r, i, x);
  return most3(x);
}

void solve(Region* r, const State* s, const Law* law, double dt, double tolerance, int sweeps) {
  // The first guess: a vertex goes on as in the step before; those outside the window stay where they are.
  memcpy(r->u, s->u, sizeof(double) * 3 * (size_t)r->nvertex);
  for (int k = 0; k < r->nwindow; k++) {
    int i = r->window[k];
    prepare(r, s, law, i, dt);
    double ahead[3];
    for (int j = 0; j < 3; j++) {
      ahead[j] = dt * s->rate[3 * i + j];
      r->u[3 * i + j] += ahead[j];
    }
    if (r->moves[i] == CLOSE) carry(r, i, ahead);
  }
  int sweep = 0, reviewed = 0;
  double worst = mjMAXVAL;
  while (sweep < sweeps) {
    double share = sweep < PATIENCE ? 1 : CAUTION;
    worst = 0;
    for (int k = 0; k < r->nwindow; k++) worst = most(worst, relax(r, law, r->window[k], share));
    sweep++;
    if (worst < tolerance && (reviewed++ || !contact_review(r, law))) break;
  }
  for (int i = 0; i < r->ncontact; i++) respond(law, r->contact + i);
  double sum = 0;
  for (int k = 0; k < r->nwindow; k++)
    for (int j = 0; j < 3; j++) {
      int at = 3 * r->window[k] + j;
      r->rate[at] = (r->u[at] - s->u[at]) / dt;
      sum += r->rate[at];
    }
  r->row[ROW_SWEEPS] = sweep;
  // A comparison with a number that is not one is false, so that neither `worst` nor a contact shows it. The sum does.
  r->row[ROW_LEFT] = most(r->row[ROW_LEFT], isfinite(sum) ? worst : mjMAXVAL);
}

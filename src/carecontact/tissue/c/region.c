// A region's arrays: read from the model's numerics once, and laid out for the step.
#include "region.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "vec.h"

enum { STATE_HEAD = 3 };

int state_size(int nvertex, int ntriangle, int ncell) {
  return STATE_HEAD + 6 * nvertex + HELD_SIZE * POINTS_EACH * ntriangle + CELL_SIZE * ncell + RING_ROWS * ROW_SIZE;
}

State state_of(const Region* r, double* state) {
  State s = {.steps = state, .awake = state + 1, .holds = state + 2};
  s.u = state + STATE_HEAD;
  s.rate = s.u + 3 * r->nvertex;
  s.held = s.rate + 3 * r->nvertex;
  s.cells = s.held + HELD_SIZE * r->npoint;
  s.ring = s.cells + CELL_SIZE * r->ncell;
  return s;
}

// How many points the state can hold.
static int held_rows(const Region* r) { return (int)((long)HELD_SIZE * r->npoint / r->held_size); }

int state_sound(const Region* r, const State* s) {
  static const double LAST = 9e15;  // up to which a double holds every whole number
  if (!counts(*s->steps, LAST) || !counts(*s->holds, r->npoint + 1)) return 0;
  if ((int)*s->holds > held_rows(r)) return 0;
  for (int k = 0; k < (int)*s->holds; k++)
    if (!counts(s->held[r->held_size * k], r->npoint)) return 0;
  return 1;
}

static int attribute(const mjModel* m, int instance, const char* name) {
  const char* text = mj_getPluginConfig(m, instance, name);
  return text ? atoi(text) : 0;
}

// The address of the numeric "<key>/<name>", which must have `size` numbers; -1 after a warning.
static int numeric(const mjModel* m, const char* key, const char* name, int size) {
  char full[256];
  snprintf(full, sizeof full, "%s/%s", key, name);
  int id = mj_name2id(m, mjOBJ_NUMERIC, full);
  if (id < 0 || m->numeric_size[id] != size) {
    mju_warning("carecontact.tissue: the model has no numeric %s of %d numbers", full, size);
    return -1;
  }
  return m->numeric_adr[id];
}

static int has_numeric(const mjModel* m, const char* key, const char* name) {
  char full[256];
  snprintf(full, sizeof full, "%s/%s", key, name);
  return mj_name2id(m, mjOBJ_NUMERIC, full) >= 0;
}

Law law_read(const mjModel* m, const Region* r) {
  const double* x = m->numeric_data + r->law_address;
  const double* contact = r->contact_address < 0 ? NULL : m->numeric_data + r->contact_address;
  double rest = (1 - LOCK_FROM) * x[LAW_THICKNESS], lock = contact ? contact[CONTACT_LOCK] * x[LAW_A] / (rest * rest) : 0;
  return (Law){x[LAW_A], x[LAW_B], x[LAW_C], x[LAW_DAMPING], x[LAW_DAMPING_GROWTH], x[LAW_MASS], x[LAW_COUPLING],
               x[LAW_MEMBRANE], x[LAW_FRICTION], x[LAW_CONTACT], x[LAW_THICKNESS], lock,
               LOCK_FROM * x[LAW_THICKNESS], lock > 0 ? mjMAXVAL : FIRM_FROM * x[LAW_THICKNESS],
               contact ? contact[CONTACT_LAYER] : 0, contact ? contact[CONTACT_ENTRY] : 0};
}

int law_sound(const Law* law) {
  const double* number = (const double*)law;
  double sum = 0;
  for (size_t k = 0; k < sizeof *law / sizeof *number; k++) sum += fabs(number[k]);
  return isfinite(sum) && law->layer >= 0 && law->entry >= 0;
}

static double distance(const double a[3], const double b[3]) {
  double away[3] = {a[0] - b[0], a[1] - b[1], a[2] - b[2]};
  return sqrt(dot(away, away));
}

// Neighbours of every vertex, both ways, in the order of the edges.
static void link_vertices(Region* r, const double* edge, int nedge) {
  for (int e = 0; e < nedge; e++)
    for (int way = 0; way < 2; way++) r->vertex[(int)edge[EDGE_SIZE * e + way]].edges++;
  for (int i = 0, at = 0; i < r->nvertex; at += r->vertex[i++].edges) r->vertex[i].edge = at;
  for (int i = 0; i < r->nvertex; i++) r->vertex[i].edges = 0;
  for (int e = 0; e < nedge; e++)
    for (int way = 0; way < 2; way++) {
      const double* row = edge + EDGE_SIZE * e;
      Vertex* v = r->vertex + (int)row[way];
      int at = v->edge + v->edges++;
      r->neighbour[at] = (int)row[1 - way];
      r->neighbour_weight[at] = row[EDGE_WEIGHT];
      v->weight += row[EDGE_WEIGHT];
      v->span = most(v->span, distance(v->place, r->vertex[(int)row[1 - way]].place));
    }
}

// One contact point of a triangle, with these shares of its corners.
static void place_point(const Region* r, Point* p, const double* row, const double share[3], double area) {
  memcpy(p->share, share, sizeof p->share);
  p->area = area;
  p->cell = (int)row[TRIANGLE_CELL];
  for (int c = 0; c < 3; c++) {
    Vertex* v = r->vertex + (int)row[TRIANGLE_CORNER + c];
    p->corner[c] = (int)row[TRIANGLE_CORNER + c];
    v->uses++;
    for (int k = 0; k < 3; k++) {
      p->place[k] += share[c] * v->place[k];
      p->inward[k] += share[c] * v->frame[k];
    }
  }
  for (int c = 0; c < 3; c++)
    for (int k = 0; k < 3; k++) p->offset[c][k] = r->vertex[p->corner[c]].place[k] - p->place[k];
  double length = sqrt(dot(p->inward, p->inward));
  for (int k = 0; k < 3; k++) p->inward[k] /= length;
}

// The contact points. The thirds lie where the rule of three points has them, which is exact for squares (Strang and Fix
// 1973).
static void place_points(Region* r, const double* row) {
  static const double SHARES[POINTS_EACH][3] = {
      {1. / 3, 1. / 3, 1. / 3}, {2. / 3, 1. / 6, 1. / 6}, {1. / 6, 2. / 3, 1. / 6}, {1. / 6, 1. / 6, 2. / 3}};
  for (int q = 0; q < r->npoint; q++) {
    int which = q % POINTS_EACH;
    const double* triangle = row + TRIANGLE_SIZE * (q / POINTS_EACH);
    r->point[q].third = which > 0;
    r->first_corner[q / POINTS_EACH] = (int)triangle[TRIANGLE_CORNER];
    place_point(r, r->point + q, triangle, SHARES[which], triangle[TRIANGLE_AREA] / (which ? 3 : 1));
  }
  for (int i = 0, at = 0; i < r->nvertex; at += r->vertex[i++].uses) r->vertex[i].use = at;
}

static void bound(Region* r) {
  for (int i = 0; i < r->nvertex; i++)
    for (int k = 0; k < 3; k++) r->middle[k] += r->vertex[i].place[k] / r->nvertex;
  for (int i = 0; i < r->nvertex; i++) {
    const double* x = r->vertex[i].place;
    double away[3] = {x[0] - r->middle[0], x[1] - r->middle[1], x[2] - r->middle[2]};
    r->bound = most(r->bound, sqrt(dot(away, away)));
    r->px[i] = (float)x[0];
    r->py[i] = (float)x[1];
    r->pz[i] = (float)x[2];
  }
}

// The part of a geom of the robot, where the attribute "tip" names the geom that is meant to touch (-1: all are).
static int part_of(const mjModel* m, int tip, int geom) {
  if (tip < 0 || geom == tip) return PART_TIP;
  return m->geom_bodyid[geom] == m->geom_bodyid[tip] ? PART_HAND : PART_LINKS;
}

// Every geom under the body named by the attribute "tools" that may collide with a person.
static int find_tools(const mjModel* m, int instance, Region* r) {
  int root = mj_name2id(m, mjOBJ_BODY, mj_getPluginConfig(m, instance, "tools"));
  if (root < 0) {
    mju_warning("carecontact.tissue: the model has no body %s", mj_getPluginConfig(m, instance, "tools"));
    return -1;
  }
  const char* named = mj_getPluginConfig(m, instance, "tip");
  int tip = named && *named ? mj_name2id(m, mjOBJ_GEOM, named) : -1;
  if (named && *named && tip < 0) {
    mju_warning("carecontact.tissue: the model has no geom %s", named);
    return -1;
  }
  r->tool = calloc((size_t)m->ngeom + 1, sizeof(Tool));
  if (!r->tool) {
    mju_warning("carecontact.tissue: no memory for the tools");
    return -1;
  }
  for (int g = 0; g < m->ngeom; g++) {
    int body = m->geom_bodyid[g];
    while (body > root) body = m->body_parentid[body];
    if (body != root || !(m->geom_contype[g] & 1)) continue;
    Tool* tool = r->tool + r->ntool++;
    if (tool_init(m, g, tool)) {
      mju_warning("carecontact.tissue: geom %d under %s has no convex surface", g,
                  mj_getPluginConfig(m, instance, "tools"));
      return -1;
    }
    tool->part = part_of(m, tip, g);
  }
  return 0;
}

// Whether edges and triangles name vertices and cells that there are; warns where they do not.
static int refers_well(const Region* r, const char* key, const double* edge, int nedge, const double* triangle,
                       int ntriangle) {
  int wrong = r->nvertex < 1 || ntriangle < 1 || nedge < 1 || r->ncell < 0;
  for (int e = 0; e < nedge; e++)
    for (int way = 0; way < 2; way++) wrong |= !counts(edge[EDGE_SIZE * e + way], r->nvertex);
  for (int t = 0; t < ntriangle; t++) {
    const double* row = triangle + TRIANGLE_SIZE * t;
    for (int c = 0; c < 3; c++) wrong |= !counts(row[TRIANGLE_CORNER + c], r->nvertex);
    wrong |= row[TRIANGLE_CELL] != -1 && !counts(row[TRIANGLE_CELL], r->ncell);
  }
  if (wrong)
    mju_warning("carecontact.tissue: edges or triangles of %s name vertices or cells outside of its %d and %d", key,
                r->nvertex, r->ncell);
  return !wrong;
}

enum { ARRAYS = 23 };

static void arrays_of(const Region* r, void* all[ARRAYS]) {
  void* each[ARRAYS] = {r->vertex, r->point, r->first_corner, r->contact, r->rim, r->neighbour, r->neighbour_weight, r->live,
                        r->live_contact, r->live_corner, r->window, r->held_of, r->moves, r->hit, r->in_patch,
                        r->patch, r->px, r->py, r->pz, r->u, r->rate, r->balance, r->force};
  memcpy(all, each, sizeof each);
}

// Returns 0, or -1 after a warning.
static int allocate(Region* r, int nedge) {
  size_t n = (size_t)r->nvertex, q = (size_t)r->npoint, e = 2 * (size_t)nedge;
  r->vertex = calloc(n, sizeof(Vertex));
  r->point = calloc(q, sizeof(Point));
  r->first_corner = calloc(q / POINTS_EACH, sizeof(int));
  r->contact = calloc(q, sizeof(Contact));
  r->neighbour = calloc(e, sizeof(int));
  r->neighbour_weight = calloc(e, sizeof(double));
  r->rim = calloc(n, sizeof(Rim));
  r->live = calloc(n, sizeof(int));
  r->live_contact = calloc(3 * q, sizeof(int));
  r->live_corner = calloc(3 * q, sizeof(int));
  r->window = calloc(n, sizeof(int));
  r->held_of = calloc(q, sizeof(int));
  r->moves = calloc(n, 1);
  r->hit = calloc(n, 1);
  r->in_patch = calloc(n, sizeof(int));
  r->patch = calloc(n, sizeof(Patch));
  r->px = calloc(n, sizeof(float));
  r->py = calloc(n, sizeof(float));
  r->pz = calloc(n, sizeof(float));
  r->u = calloc(3 * n, sizeof(double));
  r->rate = calloc(3 * n, sizeof(double));
  r->balance = calloc(n, sizeof(Balance));
  r->force = calloc((size_t)r->nv + 1, sizeof(double));
  void* all[ARRAYS];
  arrays_of(r, all);
  for (int k = 0; k < ARRAYS; k++)
    if (!all[k]) {
      mju_warning("carecontact.tissue: no memory for a region of %d vertices", r->nvertex);
      return -1;
    }
  for (size_t i = 0; i < q; i++) r->held_of[i] = -1;
  return 0;
}

int region_init(const mjModel* m, int instance, Region* r) {
  const char* key = mj_getPluginConfig(m, instance, "key");
  int nedge = attribute(m, instance, "edges");
  r->nvertex = attribute(m, instance, "vertices");
  int ntriangle = attribute(m, instance, "triangles");
  r->npoint = POINTS_EACH * ntriangle;
  r->ncell = attribute(m, instance, "cells");
  r->nv = m->nv;
  r->bone = -1;
  for (int b = 0; b < m->nbody; b++)
    if (m->body_plugin[b] == instance) r->bone = b;
  if (r->bone < 0) {
    mju_warning("carecontact.tissue: no body carries the region %s", key);
    return -1;
  }
  if (m->opt.integrator == mjINT_RK4) {
    mju_warning("carecontact.tissue: a step asks for the tissue's force once; take another integrator than RK4");
    return -1;
  }
  if (m->opt.enableflags & mjENBL_SLEEP) {
    mju_warning("carecontact.tissue: a sleeping bone would not feel the tissue; take sleeping out of the model's flags");
    return -1;
  }
  int vertices = numeric(m, key, "vertices", VERTEX_SIZE * r->nvertex);
  int edges = numeric(m, key, "edges", EDGE_SIZE * nedge);
  int triangles = numeric(m, key, "triangles", TRIANGLE_SIZE * ntriangle);
  r->law_address = numeric(m, key, "law", LAW_SIZE);
  r->option_address = numeric(m, key, "options", OPTION_SIZE);
  r->contact_address = has_numeric(m, key, "contact") ? numeric(m, key, "contact", CONTACT_SIZE) : -1;
  r->held_size = r->contact_address < 0 ? HELD_SIZE : HELD_LONG;
  if (vertices < 0 || edges < 0 || triangles < 0 || r->law_address < 0 || r->option_address < 0) return -1;
  if (has_numeric(m, key, "contact") && r->contact_address < 0) return -1;
  Law law = law_read(m, r);
  if (!law_sound(&law)) {
    mju_warning("carecontact.tissue: %s/law or %s/contact has a number that is not finite or below what it may be", key,
                key);
    return -1;
  }
  if (!(m->numeric_data[r->option_address + OPTION_SWEEPS] >= 1)) {
    mju_warning("carecontact.tissue: %s/options allows the solver no sweep", key);
    return -1;
  }
  const double *edge = m->numeric_data + edges, *triangle = m->numeric_data + triangles;
  if (!refers_well(r, key, edge, nedge, triangle, ntriangle) || allocate(r, nedge)) return -1;
  for (int i = 0; i < r->nvertex; i++) {
    const double* row = m->numeric_data + vertices + VERTEX_SIZE * i;
    memcpy(r->vertex[i].place, row + VERTEX_PLACE, 3 * sizeof(double));
    memcpy(r->vertex[i].frame, row + VERTEX_INWARD, 9 * sizeof(double));
    r->vertex[i].area = row[VERTEX_AREA];
  }
  link_vertices(r, edge, nedge);
  place_points(r, triangle);
  bound(r);
  patches_make(r);
  return find_tools(m, instance, r);
}

void region_free(Region* r) {
  for (int k = 0; k < r->ntool; k++) tool_free(r->tool + k);
  void* all[ARRAYS];
  arrays_of(r, all);
  for (int k = 0; k < ARRAYS; k++) free(all[k]);
  free(r->tool);
}

// What is not committed yet is copied as well: a copy made between a forward pass and the end of its step goes on alike.
void region_copy(Region* to, const Region* from) {
  size_t n = (size_t)from->nvertex;
  to->ready = from->ready;
  to->nwindow = from->nwindow;
  memcpy(to->window, from->window, sizeof(int) * n);
  memcpy(to->moves, from->moves, n);
  contact_forget(to);
  for (int i = 0; i < from->ncontact; i++) contact_keep(to, from->contact + i);
  memcpy(to->u, from->u, sizeof(double) * 3 * n);
  memcpy(to->rate, from->rate, sizeof(double) * 3 * n);
  memcpy(to->row, from->row, sizeof to->row);
  memcpy(to->force, from->force, sizeof(double) * (size_t)from->nv);
}

void region_step(const mjModel* m, mjData* d, Region* r, const State* s) {
  const double* option = m->numeric_data + r->option_address;
  Law law = law_read(m, r);
  memset(r->row, 0, sizeof r->row);
  memset(r->force, 0, sizeof(double) * (size_t)r->nv);
  r->ready = 1;
  // The numbers may have been changed in the compiled model.
  if (!law_sound(&law)) r->row[ROW_LEFT] = mjMAXVAL;
  window_find(m, d, r, s, option[OPTION_REACH]);
  contact_forget(r);
  // Without a vertex that may move no point can touch, and most of the time no tool is near.
  if (!r->nwindow) return;
  contact_find(r, s, &law, m->opt.timestep);
  solve(r, s, &law, m->opt.timestep, option[OPTION_TOLERANCE], (int)option[OPTION_SWEEPS]);
  rim_find(r, &law);
  wrench_apply(m, d, r, law.entry > 0);
  if (option[OPTION_LEDGER] != 0) ledger(r, s, &law);
}

// How far the tool slid in a step over skin whose middle does not touch it.
static double slid(const Contact* c) {
  double away[3] = {c->shift[0] - c->moved[0], c->shift[1] - c->moved[1], c->shift[2] - c->moved[2]};
  double along = dot(away, c->normal);
  return sqrt(most(0, dot(away, away) - along * along));
}

// What the cells of the surface feel in a step.
static void add_to_cells(const Region* r, State* s, double dt) {
  for (int i = 0; i < r->ncontact; i++) {
    const Contact* c = r->contact + i;
    const Point* p = r->point + c->point;
    if ((!c->touching && c->touched == 0) || p->cell < 0) continue;
    double* cell = s->cells + CELL_SIZE * p->cell;
    cell[CELL_PRESS] += dt * c->area * c->pressure;
    cell[CELL_SHEAR] += dt * c->area * sqrt(dot(c->traction, c->traction));
    cell[CELL_SLIP] += c->touched * (c->touching ? c->slipped : slid(c));
    cell[CELL_TOUCH] += dt * c->touched;
  }
}

void region_commit(Region* r, State* s, double dt) {
  // Without springs and dampers MuJoCo asks for no passive forces, and there is no step to commit.
  if (!r->ready) return;
  r->ready = 0;
  *s->awake = *s->holds = 0;
  for (int k = 0; k < r->nwindow; k++) {
    int at = 3 * r->window[k], still = 1;
    for (int j = at; j < at + 3; j++) still &= fabs(r->u[j]) < STILL && fabs(r->rate[j]) < STILL;
    for (int j = at; j < at + 3; j++) {
      s->u[j] = still ? 0 : r->u[j];
      s->rate[j] = still ? 0 : r->rate[j];
    }
    if (!still) *s->awake = 1;
  }
  for (int i = 0; i < r->ncontact; i++) {
    const Contact* c = r->contact + i;
    if (!c->touching) continue;
    *s->awake = 1;
    // Without a row, a point loses its friction: the step is marked as one that was not solved.
    if ((int)*s->holds == held_rows(r)) {
      r->row[ROW_LEFT] = mjMAXVAL;
      continue;
    }
    double* row = s->held + r->held_size * (int)(*s->holds)++;
    row[0] = c->point;
    memcpy(row + 1, c->traction, 3 * sizeof(double));
    if (r->held_size == HELD_LONG) {
      row[4] = c->stands_off + c->allowed - (c->gap + dot(c->normal, c->moved));
      row[5] = c->allowed;
      memcpy(row + 6, c->normal, sizeof c->normal);
      memcpy(row + 9, c->bristle, sizeof c->bristle);
    }
  }
  add_to_cells(r, s, dt);
  memcpy(s->ring + ROW_SIZE * ((long)*s->steps % RING_ROWS), r->row, sizeof r->row);
  *s->steps += 1;
}

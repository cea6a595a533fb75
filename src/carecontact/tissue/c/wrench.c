// What the contact points do together: equal and opposite forces on the bone and on the tools, and what is recorded.
#include <math.h>
#include <string.h>

#include "region.h"
#include "vec.h"

static void apply(const mjModel* m, mjData* d, Region* r, int body, const double force[3], const double torque[3]) {
  const double *R = d->xmat + 9 * r->bone, *at = d->xpos + 3 * r->bone;
  double f[3], t[3];
  rotate(f, R, force);
  rotate(t, R, torque);
  mj_applyFT(m, d, f, t, at, body, r->force);
}

// Counts the force of a geom that is not the tip to its part: 0 for the hand, 1 for the links.
static void beside(Region* r, const mjData* d, int part, const double force[3], double normal) {
  double f[3];
  rotate(f, d->xmat + 9 * r->bone, force);
  for (int j = 0; j < 3; j++) r->row[ROW_BESIDE_FORCE + 3 * part + j] += f[j];
  r->row[ROW_BESIDE_NORMAL + part] += normal;
}

void wrench_apply(const mjModel* m, mjData* d, Region* r, int lets_in) {
  double total[6] = {0}, centre[3] = {0}, weight = 0, *row = r->row;
  memset(r->force, 0, sizeof(double) * (size_t)m->nv);
  for (int k = 0; k < r->nwindow; k++) row[ROW_DEPTH] = most(row[ROW_DEPTH], r->u[3 * r->window[k]]);
  for (int t = 0; t < r->ntool; t++) {
    double force[3] = {0}, torque[3] = {0}, against[3], around[3], normal = 0;
    int touching = 0;
    for (int i = 0; i < r->ncontact; i++) {
      const Contact* c = r->contact + i;
      if (c->tool != t || !c->touching || c->area == 0) continue;
      double area = c->area, at[3], f[3], moment[3];
      touching++;
      for (int j = 0; j < 3; j++) {
        at[j] = c->at[j] + c->moved[j];
        f[j] = area * (c->pressure * c->normal[j] + c->traction[j]);
        if (lets_in) f[j] += area * c->pressure * c->drag[j];
      }
      cross(moment, at, f);
      for (int j = 0; j < 3; j++) {
        force[j] += f[j];
        torque[j] += moment[j];
        centre[j] += area * c->pressure * at[j];
      }
      normal += area * c->pressure;
      weight += area * c->pressure;
      row[ROW_PRESSURE] = most(row[ROW_PRESSURE], c->pressure);
    }
    if (!touching) continue;
    row[ROW_POINTS] += touching;
    for (int j = 0; j < 3; j++) {
      against[j] = -force[j];
      around[j] = -torque[j];
      total[j] += force[j];
      total[3 + j] += torque[j];
    }
    apply(m, d, r, r->tool[t].body, against, around);
    if (r->tool[t].part != PART_TIP) beside(r, d, r->tool[t].part - PART_HAND, force, normal);
  }
  if (!row[ROW_POINTS]) return;
  apply(m, d, r, r->bone, total, total + 3);
  for (int k = 0; k < m->nv; k++) d->qfrc_passive[k] += r->force[k];
  const double *R = d->xmat + 9 * r->bone, *at = d->xpos + 3 * r->bone;
  rotate(row + ROW_FORCE, R, total);
  row[ROW_NORMAL] = weight;
  for (int j = 0; j < 3; j++) centre[j] /= weight;
  rotate(row + ROW_CENTROID, R, centre);
  for (int j = 0; j < 3; j++) row[ROW_CENTROID + j] += at[j];
}

// The energy that the shell holds at the end of a step and what it lost during it.
#include <math.h>

#include "layer.h"
#include "region.h"
#include "vec.h"

void ledger(Region* r, const State* s, const Law* law) {
  double *row = r->row, stored = 0, kinetic = 0, damped = 0, rubbed = 0;
  for (int k = 0; k < r->nwindow; k++) {
    int i = r->window[k];
    const Vertex* v = r->vertex + i;
    const double *u = r->u + 3 * i, *rate = r->rate + 3 * i;
    double grows, across = law->a + law_firmer(law, u[0], &grows);
    stored += v->area * (law_energy(law, u[0]) + across / 2 * (u[1] * u[1] + u[2] * u[2]));
    kinetic += v->area * law->mass / 2 * dot(rate, rate);
    for (int j = 0; j < 3; j++)
      damped += v->area * law_damping(law, s->u[3 * i]) * rate[j] * (u[j] - s->u[3 * i + j]);
    for (int e = v->edge; e < v->edge + v->edges; e++) {
      const double* w = r->u + 3 * r->neighbour[e];
      // An edge between two moving vertices is met twice.
      double half = r->neighbour_weight[e] * (r->moves[r->neighbour[e]] ? 0.25 : 0.5);
      for (int j = 0; j < 3; j++) stored += half * (j ? law->membrane : law->coupling) * (u[j] - w[j]) * (u[j] - w[j]);
    }
  }
  for (int i = 0; i < r->ncontact; i++) {
    const Contact* c = r->contact + i;
    if (!c->touching) continue;
    double area = c->area, size = dot(c->traction, c->traction);
    if (law->layer > 0) {
      double depth = -(c->gap + dot(c->normal, c->moved));
      stored += area * (layer_energy(c->stiff, c->layer, depth) + size / (2 * c->stiff));
    } else {
      stored += area * (c->pressure * c->pressure + size) / (2 * c->stiff);
    }
    // By the trapezoidal rule, like the work of a spring.
    rubbed += area * (law->friction * c->pressure + sqrt(dot(c->before, c->before))) / 2 * c->slipped;
  }
  row[ROW_STORED] = stored;
  row[ROW_KINETIC] = kinetic;
  row[ROW_DAMPED] = damped;
  row[ROW_RUBBED] = rubbed;
}

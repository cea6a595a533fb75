// Skin that comes to lie in a tool without having been pressed there is let in, so that contact makes no energy.
//
// The energy of the contact layer is that of its depth. A tool that presses a point pays for it: the depth grows by the
// way of the tool towards the point. But a point can also lie deep in a tool at once, because it arrives beside an upright
// wall, or because another part of the surface becomes the one that it is measured from. Such depth comes from nowhere.
// It is the point's allowance, and does not count in the layer at first: the layer is only as deep as the tool has pressed.
//
// The tool's way over the skin uses the allowance up: a way s in one step leaves the share entry / (entry + s) of it, which
// over many short steps is a factor of e in each length `entry`. With it the layer grows deeper, and the tool pays: in
// each step, it is braked by pressure times the fall of the allowance over its way. This force acts between tool and bone:
// it is that of a ramp of the tool, over which the skin is let in, and the skin's tissue does not feel it. A tool that
// stands or goes straight in uses up nothing. An allowance below zero, after a depth has vanished at once, gives back in
// the same way.
#include <math.h>
#include <string.h>

#include "region.h"
#include "vec.h"

// The depth in a tool changes by the tool's way past the point along the normal. What is left is the bend of the surface,
// up to these shares of the way for a point that comes and for one that stays, whose normal before is known; and rounding.
static const double BENDS = 0.1, STAYS = 0.02, SLACK = 1e-5;  // SLACK: [m]
static const double STANDS = 1e-9;  // [m] a tool that moves less in a step stands
static const double UPSIDE_DOWN = 1e-3;  // 1 plus the cosine between two normals from which on no turn is known

// The part of the depth that the tool has not pressed, before its way in this step.
static double not_pressed(const Contact* c, int exact) {
  double way[3], along, layer = -(c->gap + dot(c->normal, c->seen)), depth = layer + c->stands_off;
  for (int k = 0; k < 3; k++) way[k] = c->shift[k] - c->seen[k];
  along = dot(way, c->normal);
  double bends = SLACK + (c->stayed ? STAYS : BENDS) * sqrt(dot(way, way));
  // The depth under a tangent plane can jump by any amount.
  if (!exact) bends = 0;
  if (!c->stayed) return most(0, layer - most(0, along) - bends);
  double jumped = depth - (c->depth_before + (along + dot(way, c->normal_before)) / 2);
  return c->allowed_before + (fabs(jumped) > bends ? jumped : 0);
}

void entry_allow(const Law* law, Contact* c, int exact) {
  double way[3], along = dot(c->shift, c->normal);
  memset(c->drag, 0, sizeof c->drag);
  c->allowed = not_pressed(c, exact);
  for (int k = 0; k < 3; k++) way[k] = c->shift[k] - along * c->normal[k];
  double far = sqrt(dot(way, way));
  if (c->allowed != 0 && far > STANDS) {
    double falls = c->allowed / (law->entry + far);  // per way
    for (int k = 0; k < 3; k++) c->drag[k] = falls * way[k] / far;
    c->allowed -= falls * far;
  }
  c->gap += c->allowed;
}

void entry_turn(Contact* c) {
  double both = 1 + dot(c->normal, c->normal_before);
  if (both < UPSIDE_DOWN) return;
  double along = dot(c->before, c->normal) / both;
  for (int k = 0; k < 3; k++) c->held[k] = c->before[k] - along * (c->normal[k] + c->normal_before[k]);
}

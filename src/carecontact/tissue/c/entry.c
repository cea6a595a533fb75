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
// goes straight in uses up nothing.
//
// The ramp is held by a bristle at each point, which the tool's way bends, and which slips where it is bent by BRISTLE: the
// brake grows with its bend and is full where it slips. So a tool that stands or turns round is held as by a spring; a full
// brake against every step's way would turn round in every step. The allowance falls by the brake's work, so that a
// bristle that unbends lets it grow again by as much, and a tool that goes to and fro within the bend uses up nothing. The
// bristle itself holds no energy, which is all in the layer. So it may begin straight at a new point, turn with the tool's
// surface and go over to another part of the tool, and no energy is made.
//
// An allowance below zero, after a depth has vanished at once, gives back in the same way, by a force along the bend.
#include <math.h>

#include "region.h"
#include "vec.h"

// The depth in a tool changes by the tool's way past the point along the normal. What is left is the bend of the surface,
// up to these shares of the way for a point that comes and for one that stays, whose normal before is known; and rounding.
static const double BENDS = 0.1, STAYS = 0.02, SLACK = 1e-5;  // SLACK: [m]
// [m] How far a bristle bends before it slips. About as far as the friction of the contact layer does: with a coefficient
// of 0.5 and 5e7 N/m^3, under 10 kPa. It has to be short against `entry`, so that the allowance that comes and goes with
// the bend, the share BRISTLE / (2 entry), is below 1 %, and long enough for an explicit force: a brake of 12 N on 1 kg
// that bends by so much swings within 9 steps of 2 ms.
static const double BRISTLE = 1e-4;
// Greatest fall of the allowance per way: the brake is at most this many times the press, however steep the ramp would be
// (scoring/validity/forces.py counts on it). A ramp that is less steep than this, such as 1.5, lets a cap sink into the
// abdomen that is dragged over it.
static const double STEEPEST = 2;
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

// Bends a point's bristle by the tool's way along its surface.
static void bend(Contact* c, const double way[3]) {
  double *z = c->bristle, out = dot(c->bristle_before, c->normal);
  for (int k = 0; k < 3; k++) z[k] = c->bristle_before[k] - out * c->normal[k] + way[k];
  double bent = sqrt(dot(z, z));
  if (bent <= BRISTLE) return;
  for (int k = 0; k < 3; k++) z[k] *= BRISTLE / bent;
}

void entry_allow(const Law* law, Contact* c, int exact) {
  double way[3], along = dot(c->shift, c->normal);
  c->allowed = not_pressed(c, exact);
  for (int k = 0; k < 3; k++) way[k] = c->shift[k] - along * c->normal[k];
  bend(c, way);
  double falls = c->allowed / (law->entry + sqrt(dot(way, way)));  // per way, where the bristle slips
  falls = most(-STEEPEST, least(STEEPEST, falls));
  for (int k = 0; k < 3; k++) c->drag[k] = falls * c->bristle[k] / BRISTLE;
  c->allowed -= dot(c->drag, way);
  c->gap += c->allowed;
}

void entry_turn(Contact* c) {
  double both = 1 + dot(c->normal, c->normal_before);
  if (both < UPSIDE_DOWN) return;
  double along = dot(c->before, c->normal) / both;
  for (int k = 0; k < 3; k++) c->held[k] = c->before[k] - along * (c->normal[k] + c->normal_before[k]);
}

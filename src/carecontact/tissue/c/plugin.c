// The MuJoCo engine plugin "carecontact.tissue": a passive force on the bone that carries a soft region and on the tools
// that touch it. One instance is one region; its state is the shell's.
#include "plugin.h"

#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "export.h"
#include "region.h"

static const char* ATTRIBUTES[] = {"key", "vertices", "edges", "triangles", "cells", "tools", "tip"};

static Region* region_of(const mjData* d, int instance) { return (Region*)d->plugin_data[instance]; }

static State state_in(const mjModel* m, mjData* d, int instance) {
  const Region* r = region_of(d, instance);
  State s = state_of(r, d->plugin_state + m->plugin_stateadr[instance]);
  if (!state_sound(r, &s))
    mju_error("carecontact.tissue: plugin_state of %s was not written by it, or for another model",
              mj_getPluginConfig(m, instance, "key"));
  return s;
}

// The compiler asks before it has copied the numerics, so that the counts have to be attributes.
static int count(const mjModel* m, int instance, const char* name) {
  const char* text = mj_getPluginConfig(m, instance, name);
  return text ? atoi(text) : 0;
}

static int nstate(const mjModel* m, int instance) {
  return state_size(count(m, instance, "vertices"), count(m, instance, "triangles"), count(m, instance, "cells"));
}

static int init(const mjModel* m, mjData* d, int instance) {
  Region* r = calloc(1, sizeof *r);
  if (!r) return -1;
  if (region_init(m, instance, r)) {
    region_free(r);
    free(r);
    return -1;
  }
  d->plugin_data[instance] = (uintptr_t)r;
  return 0;
}

static void destroy(mjData* d, int instance) {
  Region* r = region_of(d, instance);
  if (!r) return;
  region_free(r);
  free(r);
  d->plugin_data[instance] = 0;
}

static void reset(const mjModel* m, mjtNum* state, void* data, int instance) {
  memset(state, 0, sizeof(double) * (size_t)m->plugin_statenum[instance]);
  if (data) ((Region*)data)->ready = 0;
}

static void copy(mjData* to, const mjModel* m, const mjData* from, int instance) {
  (void)m;
  region_copy(region_of(to, instance), region_of(from, instance));
}

static void compute(const mjModel* m, mjData* d, int instance, int capability) {
  (void)capability;
  State s = state_in(m, d, instance);
  region_step(m, d, region_of(d, instance), &s);
}

static void advance(const mjModel* m, mjData* d, int instance) {
  State s = state_in(m, d, instance);
  region_commit(region_of(d, instance), &s, m->opt.timestep);
}

// The generalised force (nv) of the tissue in the last forward pass, which is part of qfrc_passive.
EXPORT void carecontact_tissue_force(const mjData* d, int instance, double* out) {
  const Region* r = region_of(d, instance);
  memcpy(out, r->force, sizeof(double) * (size_t)r->nv);
}

// The row (ROW_SIZE) of the last forward pass, which the ring gets at the end of the step.
EXPORT void carecontact_tissue_row(const mjData* d, int instance, double* out) {
  memcpy(out, region_of(d, instance)->row, sizeof(double) * ROW_SIZE);
}

void tissue_plugin(mjpPlugin* plugin) {
  plugin->name = TISSUE_PLUGIN;
  plugin->capabilityflags = mjPLUGIN_PASSIVE;
  plugin->nattribute = sizeof ATTRIBUTES / sizeof *ATTRIBUTES;
  plugin->attributes = ATTRIBUTES;
  plugin->nstate = nstate;
  plugin->init = init;
  plugin->destroy = destroy;
  plugin->copy = copy;
  plugin->reset = reset;
  plugin->compute = compute;
  plugin->advance = advance;
}

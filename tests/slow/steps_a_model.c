// Steps a model, copies and resets its data in between and frees everything, so that the leak check of the
// address sanitizer sees what the plugin does not free. Python's own memory would hide that.
// Usage: steps_a_model MODEL.xml STEPS
#include <mujoco/mujoco.h>
#include <stdio.h>
#include <stdlib.h>

int main(int count, char** arguments) {
  if (count != 3) return 2;
  char error[1000] = "";
  mjModel* model = mj_loadXML(arguments[1], NULL, error, sizeof error);
  if (!model) {
    fprintf(stderr, "%s\n", error);
    return 3;
  }
  mjData* data = mj_makeData(model);
  int steps = atoi(arguments[2]);
  for (int k = 0; k < steps; k++) mj_step(model, data);
  mjData* copy = mj_copyData(NULL, model, data);
  mj_resetData(model, data);
  for (int k = 0; k < steps; k++) mj_step(model, k % 2 ? data : copy);
  printf("%d plugin instances, %g s\n", (int)model->nplugin, data->time + copy->time);
  mj_deleteData(copy);
  mj_deleteData(data);
  mj_deleteModel(model);
  return 0;
}

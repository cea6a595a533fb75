(function () {
  var table = document.getElementById("trial-table"), form = document.getElementById("filter");
  var bodies = Array.prototype.slice.call(table.tBodies), heads = table.tHead.rows[0].cells;
  var task = document.getElementById("filter-task"), result = document.getElementById("filter-result");
  var words = document.getElementById("filter-words"), count = document.getElementById("filter-count");
  function filter() {
    var wanted = words.value.toLowerCase().split(" "), shown = 0;
    bodies.forEach(function (body) {
      var text = body.textContent.toLowerCase();
      var fits = (!task.value || body.dataset.task === task.value) &&
        (!result.value || body.dataset.result === result.value) &&
        wanted.every(function (word) { return text.indexOf(word) >= 0; });
      body.hidden = !fits;
      shown += fits;
    });
    count.textContent = shown + " of " + bodies.length + (bodies.length === 1 ? " trial" : " trials");
  }
  function value(body, column) {
    var cell = body.rows[0].cells[column], text = cell.dataset.v || cell.textContent, number = parseFloat(text);
    return cell.classList.contains("num") ? (isNaN(number) ? Infinity : number) : text;
  }
  function sort(column, up) {
    bodies.map(function (body, place) { return [value(body, column), place, body]; }).sort(function (a, b) {
      var order = a[0] < b[0] ? -1 : a[0] > b[0] ? 1 : 0;
      if (a[0] === Infinity || b[0] === Infinity) { return order || a[1] - b[1]; }
      return (up ? order : -order) || a[1] - b[1];
    }).forEach(function (row) { table.appendChild(row[2]); });
    Array.prototype.forEach.call(heads, function (head, place) {
      head.setAttribute("aria-sort", place !== column ? "none" : up ? "ascending" : "descending");
    });
  }
  Array.prototype.forEach.call(heads, function (head, column) {
    var button = document.createElement("button");
    button.type = "button";
    button.textContent = head.textContent;
    head.textContent = "";
    head.appendChild(button);
    button.addEventListener("click", function () { sort(column, head.getAttribute("aria-sort") !== "ascending"); });
  });
  [task, result].forEach(function (field) { field.addEventListener("change", filter); });
  words.addEventListener("input", filter);
  form.addEventListener("submit", function (event) { event.preventDefault(); });
  form.hidden = false;
  filter();
})();

// The search takes a dash before a word as "without it", so that `--shard` finds nothing: let it see words without dashes.
document$.subscribe(() => {
  const field = document.querySelector("[data-md-component=search-query]");
  const own = Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, "value");
  if (!field || Object.hasOwn(field, "value")) return;
  Object.defineProperty(field, "value", {
    get() { return own.get.call(this).replace(/(^|\s)-+(?=\S)/g, "$1"); },
    set(text) { own.set.call(this, text); },
  });
});

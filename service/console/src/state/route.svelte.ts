/** Where the reader is, as the part of the address behind `#`: it needs nothing of the server, and a link leads back to it. */

export interface Route {
  view: "maps" | "map" | "localize" | "answer" | "batches" | "batch" | "operations";
  id: string;
  /** Of a map's page: the answer that is shown. */
  answer: string;
}

let current = $state(parse(location.hash));

window.addEventListener("hashchange", () => {
  current = parse(location.hash);
  window.scrollTo(0, 0);
});

export const route = {
  get current(): Route {
    return current;
  },
};

export function go(path: string): void {
  location.hash = path;
}

export function parse(hash: string): Route {
  const [first = "", id = "", third = "", fourth = ""] = hash.replace(/^#\/?/, "").split("/").map(decodeURIComponent);
  if (first === "maps" && id) return { view: "map", id, answer: third === "answers" ? fourth : "" };
  if (first === "answers" && id) return { view: "answer", id, answer: id };
  if (first === "batches") return { view: id ? "batch" : "batches", id, answer: "" };
  if (first === "localize" || first === "operations") return { view: first, id: "", answer: "" };
  return { view: "maps", id: "", answer: "" };
}

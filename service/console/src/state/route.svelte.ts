/** Where the reader is, as the part of the address behind `#`: it needs nothing of the server, and a link leads back to it. */

export interface Route {
  view: "maps" | "map" | "localize" | "answer" | "batches" | "batch" | "place" | "control" | "operations";
  id: string;
  /** Of a map's page: the answer that is shown. */
  answer: string;
  /** Of the page on which a photo is placed by hand: its number in the batch. */
  number: number;
}

let current = $state(parse(location.hash));

window.addEventListener("hashchange", () => {
  if (JSON.stringify(parse(location.hash)) === JSON.stringify(current)) return;
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
  const nowhere = { id, answer: "", number: 0 };
  if (first === "maps" && id && third === "control") return { ...nowhere, view: "control" };
  if (first === "maps" && id) return { ...nowhere, view: "map", answer: third === "answers" ? fourth : "" };
  if (first === "answers" && id) return { ...nowhere, view: "answer", answer: id };
  if (first === "batches" && id && third === "place" && /^\d+$/.test(fourth)) return { ...nowhere, view: "place", number: Number(fourth) };
  if (first === "batches") return { ...nowhere, view: id ? "batch" : "batches" };
  if (first === "localize" || first === "operations") return { ...nowhere, view: first, id: "" };
  return { ...nowhere, view: "maps", id: "" };
}

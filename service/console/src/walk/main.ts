import { mount } from "svelte";

import "../theme.css";
import { walkData } from "./walk_data.ts";
import WalkPage from "./WalkPage.svelte";

const target = document.getElementById("walk");
if (target === null) throw new Error("expected the element #walk in the page");
const data = walkData();
document.title = data.title;
mount(WalkPage, { target, props: { data } });

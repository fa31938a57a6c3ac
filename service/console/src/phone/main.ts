import { mount } from "svelte";

import { key } from "../api/key.svelte.ts";
import "../theme.css";
import PhonePage from "./PhonePage.svelte";

// The link carries the key in its fragment, which browsers send to nobody.
const given = new URLSearchParams(location.hash.slice(1)).get("key");
if (given) key.value = given;

const target = document.getElementById("phone");
if (target === null) throw new Error("expected the element #phone in the page");
mount(PhonePage, { target, props: { mapId: decodeURIComponent(location.pathname.split("/").pop() ?? "") } });

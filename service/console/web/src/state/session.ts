import { computed, signal } from "@preact/signals";
import { api, resultOf, type Caller } from "../net/api";
import { findText } from "../texts/translate";

/** The signed-in caller; null: nobody; undefined: not requested yet. */
export const caller = signal<Caller | null | undefined>(undefined);

const RANKS = ["viewer", "operator", "maintainer"];

function atLeast(role: string) {
  return computed(() => RANKS.indexOf(caller.value?.role ?? "") >= RANKS.indexOf(role));
}

/** Whether the caller may scan. The service decides; the console only hides what is of no use. */
export const canOperate = atLeast("operator");
/** Whether the caller may acknowledge faults and calibrate. */
export const canMaintain = atLeast("maintainer");

/** Request the signed-in caller. */
export async function refreshSession(): Promise<void> {
  caller.value = (await resultOf(api.GET("/api/session"))).caller;
}

/** Sign in with a token. */
export async function signIn(token: string): Promise<void> {
  caller.value = (await resultOf(api.POST("/api/session", { body: { token } }))).caller;
}

/** Sign out of this browser. */
export async function signOut(): Promise<void> {
  await resultOf(api.DELETE("/api/session"));
  await refreshSession();
}

/** Return name and role of the caller, for people. */
export function callerNames(): { name: string; role: string } {
  const { name = "", role = "" } = caller.value ?? {};
  return { name, role: findText(`app.role_name.${role}`) ?? role };
}
